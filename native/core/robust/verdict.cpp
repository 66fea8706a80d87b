// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/verdict.h"

#include <algorithm>
#include <cmath>

#include "core/constants.h"

namespace epi360 {
namespace {

constexpr double kFalseAlarms = -3.0;    // log10; accepted below
constexpr double kLargestChance = 0.6;   // of a wrong match inside the gate: then it tells nothing
constexpr double kRotationMostly = 0.5;  // of the inliers: it may explain them
// A translation is claimed where the inliers reject the rotation alone, once in 30,000 falsely if
// noise is Gaussian, and know its direction.
constexpr double kRotationRejected = 4.0;
constexpr double kUnknownDirection = 25.0 * kDegree, kUnknownRotation = 20.0 * kDegree;
constexpr double kKnownRotation = 5.0 * kDegree;
// Median parallax in units of the noise, under which a rotation is tried: a pure rotation
// shows 1.7.
constexpr double kSmallParallax = 4.0;
// Logistic regression of right poses against wrong ones of real pairs (benchmarks/trust.py), on the
// log-likelihood ratio of the regions and the logarithm of the direction's standard deviation.
constexpr double kLogOdds = -2.7, kLogOddsPerRatio = 0.11, kLogOddsPerSigma = -1.2;
constexpr double kLogOddsPerMajority = 6.0;
constexpr double kLeastProbability = 0.85;
constexpr double kFewestRegions = 4.5;  // five unknowns need five witnesses
constexpr double kPlaneShare = 0.9;     // of the inliers on one plane
constexpr double kPlaneSpread = 3.0;    // standard deviations of the log-likelihood ratio
constexpr double kRivalProbability = 0.5;
constexpr double kRivalEvidence = -6.0;  // a second pose this likely (log) makes a pair ambiguous
// A wrong pose on real images rested on 5 of 48 cells while the matches covered 21; the poorest
// right one covers 8 of 25. A lens that sees little covers little with all of its matches.
constexpr double kPatchCells = 6.0 / 48.0, kPatchShare = 0.35;
constexpr double kPatchSpread = 0.03;         // as of a cone of 28 degrees
constexpr double kPatchRelativeSpread = 0.2;  // of that of all matches
// Measured on real pairs: directions are wrong under about 3 times the noise, good from 6 to 7.
constexpr double kCertainParallax = 6.0;
constexpr double kPartialCoverage = 0.5;  // of what all matches cover

bool is_rotation(const Evidence& e) {
  // Where it moved a little, but nobody can tell where to, the rotation is what can be said.
  const bool is_all = e.direction_sigma > kUnknownDirection && e.rotation_sigma < kKnownRotation;
  return rotation_explains(e) && (e.rotation_rejection < kRotationRejected || is_all);
}

// Share of the matches that agree, beyond one half: repeated structures rarely make up most of
// them.
double majority_of(const Evidence& e) {
  if (e.num_effective <= 0) return 0.0;
  return std::max(0.0, static_cast<double>(e.support) / e.num_effective - 0.5);
}

bool is_chance(const Evidence& e) {
  return e.log10_false_alarms > kFalseAlarms || e.chance > kLargestChance;
}

bool is_undetermined(const Evidence& e) {
  return e.direction_sigma > kUnknownDirection || e.rotation_sigma > kUnknownRotation ||
         e.num_regions < kFewestRegions;
}

// On a plane both poses are right but for noise, whose log-likelihoods differ by about the root of
// the number of matches; elsewhere a rival must be nearly as likely.
bool has_rival(const Evidence& e) {
  const double spread = e.has_twin ? kPlaneSpread * std::sqrt(static_cast<double>(e.support)) : 0.0;
  // With gravity known, a pose that the regions do not believe in is no rival either.
  const bool is_probable = !e.has_prior || e.rival_probability > kRivalProbability;
  return e.rival_evidence > kRivalEvidence - spread && is_probable;
}

bool is_patch(const Evidence& e) {
  // Also at a pole, which is a corner of many cells.
  if (e.spread < kPatchSpread && e.spread < kPatchRelativeSpread * e.spread_of_matches) return true;
  // Cameras that stand upright leave a patch less to lie about.
  return !e.has_prior && e.coverage <= kPatchCells && e.coverage < kPatchShare * e.match_coverage;
}

Status status_of(const Evidence& e) {
  if (e.num_usable < fewest_matches(e.sample_size)) return Status::kTooFewMatches;
  const bool rotation = is_rotation(e);
  if (!rotation && is_chance(e)) return Status::kTooFewInliers;
  if (e.num_distinct < e.min_num_inliers) return Status::kTooFewInliers;
  if (is_patch(e)) return Status::kConcentratedInliers;
  if (rotation) {
    return e.turn_sigma > kUnknownRotation ? Status::kConcentratedInliers : Status::kPureRotation;
  }
  if (is_undetermined(e)) return Status::kConcentratedInliers;
  if (!(probability_of_pose(e) >= kLeastProbability)) return Status::kTooFewInliers;
  return has_rival(e) ? Status::kPlanarAmbiguous : Status::kOk;
}

}  // namespace

const char* name_of(Status status) {
  switch (status) {
    case Status::kOk:
      return "ok";
    case Status::kTooFewMatches:
      return "too_few_matches";
    case Status::kTooFewInliers:
      return "too_few_inliers";
    case Status::kPureRotation:
      return "pure_rotation";
    case Status::kPlanarAmbiguous:
      return "planar_ambiguous";
    case Status::kConcentratedInliers:
      break;
  }
  return "concentrated_inliers";
}

const char* name_of(WarningCode code) {
  switch (code) {
    case WarningCode::kMissingMatches:
      return "missing_matches";
    case WarningCode::kLittleParallax:
      return "little_parallax";
    case WarningCode::kPartialCoverage:
      return "partial_coverage";
    case WarningCode::kMuchNoise:
      break;
  }
  return "much_noise";
}

int fewest_matches(int sample_size) { return std::max(sample_size, 5); }

bool has_translation(Status status) {
  return status == Status::kOk || status == Status::kPlanarAmbiguous;
}

bool is_worth_a_look(const Evidence& e) {
  return std::isfinite(e.log_ratio) && e.support > 0 && probability_of_pose(e) > 0.5;
}

bool rotation_explains(const Evidence& e) {
  return e.rotation_support > 0 && e.rotation_support >= kRotationMostly * e.support &&
         e.rotation_log10_false_alarms < kFalseAlarms;
}

bool lacks_direction(const Evidence& e) {
  return rotation_explains(e) && e.rotation_rejection >= kRotationRejected &&
         e.direction_sigma > kUnknownDirection;
}

bool has_hardly_any_parallax(const Evidence& e) { return e.parallax < kSmallParallax * e.scale; }

double probability_of_pose(const Evidence& e) {
  const double log_odds = kLogOdds + kLogOddsPerRatio * e.log_ratio +
                          kLogOddsPerSigma * std::log(std::max(e.regional_sigma, 1e-6) / kDegree) +
                          kLogOddsPerMajority * majority_of(e) + e.log_prior;
  return 1.0 / (1.0 + std::exp(-log_odds));
}

bool is_planar(double share_on_plane) { return share_on_plane > kPlaneShare; }

Verdict judge(const Evidence& e) {
  Verdict verdict{status_of(e), {}};
  const auto warn = [&](WarningCode code, double value, double reference) {
    verdict.warnings.push_back({code, value, reference});
  };
  const int missing = e.num_matches - e.num_usable;
  if (missing > 0 && verdict.status != Status::kTooFewMatches) {
    warn(WarningCode::kMissingMatches, missing, e.num_matches);
  }
  if (!has_translation(verdict.status)) return verdict;
  if (e.parallax < kCertainParallax * e.scale) {
    warn(WarningCode::kLittleParallax, e.parallax, e.scale);
  }
  if (e.coverage < kPartialCoverage * e.match_coverage) {
    warn(WarningCode::kPartialCoverage, e.coverage, e.match_coverage);
  }
  if (verdict.status == Status::kOk && e.max_noise > 0.0 && e.noise >= e.max_noise) {
    warn(WarningCode::kMuchNoise, e.noise, e.max_noise);
  }
  return verdict;
}

}  // namespace epi360
