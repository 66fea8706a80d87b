// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/verdict.h"

#include <algorithm>
#include <cmath>

#include "core/constants.h"

namespace epi360 {
namespace {

// A pose or a rotation is said if it is so much more probable than each other explanation alone;
// LEAST_PROBABILITY of Python.
constexpr double kAccepted = 0.85;
const double kAcceptedLogOdds = std::log(kAccepted / (1.0 - kAccepted));

// Error rates of the tests, at which what they test is as probable as kAccepted says.
constexpr double kFalseAlarms = -3.0;    // log10: poses with so many inliers that chance makes
constexpr double kLargestChance = 0.6;   // of a wrong match inside the gate: then it tells nothing
constexpr double kRotationMostly = 0.4;  // of the inliers: it may explain them
// Standard deviations: once in 30,000 true rotations are rejected if noise is Gaussian, and once in
// 700 true planes.
constexpr double kRotationRejected = 4.0, kPlaneRejected = 3.0;
constexpr double kRivalRejected = 6.0;  // log-likelihood that a second pose lacks
// What all matches say of a second pose counts no more than this log-odds beyond what the regions,
// of which each is one witness, say of it: matches of one thing move together.
constexpr double kMostBesideRegions = 6.0;
// Standard deviations by which a motion must have more matches of its own than another one. Where a
// train or a copy shows half as many things as the place itself, it may have more by chance.
constexpr double kRivalOutnumbered = 2.0;
// Share of the inliers, and how many at the least, that lie behind a camera if an image is
// mirrored: there 0.28 to 0.97 do, and of right poses up to 0.18.
constexpr double kMirroredShare = 0.23, kFewestMirrored = 10.0;
// The same of matches behind, of a camera that has only turned beside a mirrored image: there 0.11
// and more, of right poses hardly one.
constexpr double kMirroredTurnShare = 0.07;
// Noise over the limit that the user knows: from so many times it on a pose is not said, and its
// log-odds fall by so much for each factor of e. Right poses of real pictures have up to 1.1 times.
constexpr double kMostNoise = 3.0, kLogOddsPerNoise = -8.0;

// What the matches must determine.
constexpr double kUnknownDirection = 25.0 * kDegree, kUnknownRotation = 20.0 * kDegree;
constexpr double kKnownRotation = 5.0 * kDegree;
constexpr double kFewestRegions = 4.5;  // five unknowns need five witnesses
// Median parallax in units of the noise, under which a rotation is tried: a pure rotation
// shows 1.7.
constexpr double kSmallParallax = 4.0;
constexpr double kPlaneShare = 0.9;  // of the inliers on one plane, that make it a surface
constexpr double kRivalProbability = 0.5;

// Logistic regression of right poses against wrong ones of real pairs (benchmarks/trust.py), on the
// log-likelihood ratio of the regions and the logarithm of the direction's standard deviation. The
// ratio counts a ninth: neighbouring regions are wrong together.
constexpr double kLogOdds = -2.7, kLogOddsPerRatio = 0.11, kLogOddsPerSigma = -1.2;
constexpr double kLogOddsPerMajority = 6.0;
constexpr double kCertain = 50.0;  // log-odds beyond which numbers tell nothing

// A wrong pose on real images rested on 5 of 48 cells while the matches covered 21; the poorest
// right one covers 8 of 25. A lens that sees little covers little with all of its matches.
constexpr double kPatchCells = 6.0 / 48.0, kPatchShare = 0.35;
constexpr double kPatchSpread = 0.03;         // as of a cone of 28 degrees
constexpr double kPatchRelativeSpread = 0.2;  // of that of all matches
// Measured on real pairs: directions are wrong under about 3 times the noise, good from 6 to 7.
constexpr double kCertainParallax = 6.0;
constexpr double kPartialCoverage = 0.5;  // of what all matches cover
constexpr double kTurnedOfPose = 0.7;     // of what the inliers of a pose cover that may be right
constexpr double kTiltRejected = 5.0;     // standard deviations

// Log-odds from standard deviations: those of the likelihoods of a Gaussian, the odds of what is
// accepted at the limit of a test.
double log_odds_of_test(double deviations, double limit) {
  return 0.5 * (deviations * std::abs(deviations) - limit * limit) + kAcceptedLogOdds;
}

// Log-odds against background alone, from the false alarms that chance makes.
double log_odds_by_chance(double log10_false_alarms) {
  return kAcceptedLogOdds - std::log(10.0) * (log10_false_alarms - kFalseAlarms);
}

double bounded(double log_odds) { return std::min(std::max(log_odds, -kCertain), kCertain); }

// Share of the matches that agree, beyond one half: repeated structures rarely make up most of
// them.
double majority_of(const Evidence& e, int support) {
  if (e.num_effective <= 0) return 0.0;
  return std::max(0.0, static_cast<double>(support) / e.num_effective - 0.5);
}

double log_odds_by_regions(const Evidence& e) {
  return kLogOdds + kLogOddsPerRatio * e.log_ratio +
         kLogOddsPerSigma * std::log(std::max(e.regional_sigma, 1e-6) / kDegree) +
         kLogOddsPerMajority * majority_of(e, e.support) + e.log_prior;
}

bool is_too_noisy(const Evidence& e) { return e.max_noise > 0.0 && e.noise >= e.max_noise; }

// Against background alone, from noise that the key points should not have.
double log_odds_by_noise(const Evidence& e) {
  if (!is_too_noisy(e)) return Evidence::kInfinity;
  return kAcceptedLogOdds + kLogOddsPerNoise * std::log(e.noise / (kMostNoise * e.max_noise));
}

// Of what inliers say that crowd, where one match of each region says something else: which of both
// is right, nothing tells.
double log_odds_of_crowd(const Evidence& e) { return e.is_only_crowd ? 0.0 : Evidence::kInfinity; }

bool is_chance(const Evidence& e) {
  return e.log10_false_alarms > kFalseAlarms || e.chance > kLargestChance;
}

bool is_mirrored(const Evidence& e) {
  return e.behind >= std::max(kFewestMirrored, kMirroredShare * e.support);
}

bool is_mirrored_turn(const Evidence& e) {
  return e.mirrored_turn >= std::max(kFewestMirrored, kMirroredTurnShare * e.support);
}

double log_odds_of_pose(const Evidence& e) {
  if (e.chance > kLargestChance || is_mirrored(e) || is_mirrored_turn(e)) return -kCertain;
  return bounded(std::min({log_odds_by_regions(e), log_odds_by_chance(e.log10_false_alarms),
                           log_odds_by_noise(e), log_odds_of_crowd(e)}));
}

// Of a rotation that the inliers do not reject, against background alone.
double log_odds_of_rotation(const Evidence& e) {
  const double by_regions = kLogOdds + kLogOddsPerRatio * e.rotation_log_ratio +
                            kLogOddsPerMajority * majority_of(e, e.rotation_support);
  return bounded(std::min(by_regions, log_odds_by_chance(e.rotation_log10_false_alarms)));
}

// Of the pose over another motion, by the matches of their own, which are independent.
double log_odds_by_number(const Evidence& e) {
  if (!(e.only_rival > 0.0)) return kCertain;
  const double deviations =
      (e.only_pose - e.only_rival) / std::sqrt(e.only_pose + e.only_rival) / kRivalOutnumbered;
  return kAcceptedLogOdds * deviations * std::abs(deviations);
}

// Of the pose that was found over a second one; two that are equally likely are equally probable.
// On a plane both are right but for noise, whose log-likelihoods differ by about the root of the
// number of matches.
double log_odds_over_rival(const Evidence& e) {
  if (e.num_contradicting > 0) return 0.0;
  const bool is_believed = e.rival_probability > kRivalProbability;
  if (e.has_twin) {
    const double lack = std::max(-e.rival_evidence - kRivalRejected, 0.0);
    const double deviations = lack / std::sqrt(std::max(e.support, 1));
    return bounded(kAcceptedLogOdds * std::pow(deviations / kPlaneRejected, 2.0));
  }
  // With gravity known, a pose that the regions do not believe in is no rival either.
  if (e.has_prior && !is_believed) return kCertain;
  const bool has_heard = std::isfinite(e.rival_regions);
  double log_odds = -e.rival_evidence * kAcceptedLogOdds / kRivalRejected;
  if (has_heard) {
    log_odds = std::min(std::max(log_odds, e.rival_regions - kMostBesideRegions),
                        e.rival_regions + kMostBesideRegions);
  }
  if (is_believed) {
    // Numbers make no pose the less probable one of two if the regions favour it.
    const double least = has_heard ? std::min(e.rival_regions, 0.0) : -kCertain;
    log_odds = std::min(log_odds, std::max(log_odds_by_number(e), least));
  }
  return bounded(log_odds);
}

// Of one surface over a general scene: standard deviations by which the inliers off it are fewer or
// more than a surface may have.
double log_odds_of_surface(const Evidence& e) {
  const double n = std::max(e.support, 1), off = (1.0 - kPlaneShare) * n;
  const double excess = ((1.0 - e.plane_share) * n - off) / std::sqrt(kPlaneShare * off);
  return bounded(-0.5 * excess * std::abs(excess));
}

double found(const Explanations& x) { return x.motion + x.surface; }

// Whether the first of two explanations is probable enough beside the second.
bool beats(double first, double second) { return first >= kAccepted * (first + second); }

bool is_rotation(const Evidence& e, const Explanations& x) {
  if (!rotation_explains(e)) return false;
  // Where it moved a little, but nobody can tell where to, the rotation is what can be said.
  const bool is_all = e.direction_sigma > kUnknownDirection && e.rotation_sigma < kKnownRotation;
  return !beats(found(x), x.rotation) || is_all;
}

bool is_undetermined(const Evidence& e) {
  return e.direction_sigma > kUnknownDirection || e.rotation_sigma > kUnknownRotation ||
         e.num_regions < kFewestRegions;
}

bool is_patch(const Evidence& e) {
  // Also at a pole, which is a corner of many cells.
  if (e.spread < kPatchSpread && e.spread < kPatchRelativeSpread * e.spread_of_matches) return true;
  // Cameras that stand upright leave a patch less to lie about.
  return !e.has_prior && e.coverage <= kPatchCells && e.coverage < kPatchShare * e.match_coverage;
}

Status status_of(const Evidence& e) {
  if (e.num_usable < fewest_matches(e.sample_size)) return Status::kTooFewMatches;
  const Explanations x = explain(e);
  const bool rotation = is_rotation(e, x);
  if (!rotation && is_chance(e)) return Status::kTooFewInliers;
  if (e.num_distinct < e.min_num_inliers) return Status::kTooFewInliers;
  if (is_patch(e)) return Status::kConcentratedInliers;
  if (rotation) {
    if (!beats(found(x) + x.rotation, x.nothing)) return Status::kTooFewInliers;
    const bool is_known = e.turn_sigma <= kUnknownRotation && !turned_in_part(e);
    return is_known ? Status::kPureRotation : Status::kConcentratedInliers;
  }
  if (is_undetermined(e) || e.is_only_crowd) return Status::kConcentratedInliers;
  if (!beats(found(x), x.nothing)) return Status::kTooFewInliers;
  if (!beats(found(x), x.rival)) return Status::kPlanarAmbiguous;
  return found(x) >= kAccepted ? Status::kOk : Status::kTooFewInliers;
}

bool is_refused_for_noise(Evidence e) {
  if (!is_too_noisy(e) || status_of(e) != Status::kTooFewInliers) return false;
  e.max_noise = 0.0;
  return status_of(e) == Status::kOk;
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
      return "much_noise";
    case WarningCode::kMirrored:
      return "mirrored";
    case WarningCode::kMirroredTurn:
      return "mirrored_turn";
    case WarningCode::kAgainstGravity:
      return "against_gravity";
    case WarningCode::kDisplaced:
      return "displaced";
    case WarningCode::kCopies:
      return "copies";
    case WarningCode::kMotionBeside:
      return "motion_beside";
    case WarningCode::kOneSide:
      return "one_side";
    case WarningCode::kOnlyCrowd:
      return "only_crowd";
    case WarningCode::kFixedContent:
      break;
  }
  return "fixed_content";
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

bool covers_little(const Evidence& e) { return e.coverage < kPartialCoverage * e.match_coverage; }

bool turned_in_part(const Evidence& e) {
  return covers_little(e) && e.coverage < kTurnedOfPose * e.pose_coverage;
}

bool has_hardly_any_parallax(const Evidence& e) { return e.parallax < kSmallParallax * e.scale; }

Explanations explain(const Evidence& e) {
  if (e.num_usable < fewest_matches(e.sample_size)) return {};
  double pose = log_odds_of_pose(e), rotation = -Evidence::kInfinity;
  if (rotation_explains(e)) {
    const double over_rotation = bounded(log_odds_of_test(e.rotation_rejection, kRotationRejected));
    if (e.rotation_rejection < kRotationRejected) {  // it says what is to be said
      rotation = log_odds_of_rotation(e);
      pose = std::min(pose, rotation + over_rotation);
    } else {
      rotation = pose - over_rotation;
    }
  }
  const double rival = pose - log_odds_over_rival(e);
  const double highest = std::max({0.0, pose, rotation, rival});
  const double surface_share = 1.0 / (1.0 + std::exp(-log_odds_of_surface(e)));
  Explanations x;
  x.nothing = std::exp(-highest);
  x.rotation = std::exp(rotation - highest);
  x.surface = surface_share * std::exp(pose - highest);
  x.motion = (1.0 - surface_share) * std::exp(pose - highest);
  x.rival = std::exp(rival - highest);
  const double sum = x.nothing + x.rotation + x.surface + x.motion + x.rival;
  for (double* each : {&x.nothing, &x.rotation, &x.surface, &x.motion, &x.rival}) *each /= sum;
  return x;
}

double odds_of_rival(const Evidence& e) {
  const double log_odds = log_odds_over_rival(e);
  return log_odds < kAcceptedLogOdds ? std::exp(-log_odds) : 0.0;
}

double probability_of_pose(const Evidence& e) { return found(explain(e)); }

double lead_by_regions(const Evidence& pose, const Evidence& rival) {
  const double sharper = std::max(rival.regional_sigma, 1e-6) / std::max(pose.regional_sigma, 1e-6);
  return kLogOddsPerRatio * (pose.log_ratio - rival.log_ratio) -
         kLogOddsPerSigma * std::log(sharper);
}

double probability_by_regions(const Evidence& e) {
  return 1.0 / (1.0 + std::exp(-log_odds_by_regions(e)));
}

bool is_planar(double share_on_plane) { return share_on_plane > kPlaneShare; }

Verdict judge(const Evidence& e) {
  Verdict verdict{status_of(e), {}};
  const auto warn = [&](WarningCode code, double value, double reference) {
    verdict.warnings.push_back({code, value, reference});
  };
  const int missing =
      e.num_matches - e.num_copies - e.num_usable - e.num_fixed - e.num_contradicting;
  if (missing > 0) warn(WarningCode::kMissingMatches, missing, e.num_matches);
  if (e.num_copies > 0) warn(WarningCode::kCopies, e.num_copies, e.num_matches);
  if (e.num_fixed > 0) warn(WarningCode::kFixedContent, e.num_fixed, e.num_matches);
  if (verdict.status == Status::kTooFewInliers && is_mirrored(e)) {
    warn(WarningCode::kMirrored, e.behind, e.support);
  } else if (verdict.status == Status::kTooFewInliers && is_mirrored_turn(e)) {
    warn(WarningCode::kMirroredTurn, e.mirrored_turn, e.support);
  }
  if (is_refused_for_noise(e)) warn(WarningCode::kMuchNoise, e.noise, e.max_noise);
  const bool has_pose = has_translation(verdict.status);
  if (verdict.status == Status::kConcentratedInliers) {
    if (e.is_only_crowd) warn(WarningCode::kOnlyCrowd, e.support, e.num_regions);
    if (turned_in_part(e)) warn(WarningCode::kPartialCoverage, e.coverage, e.match_coverage);
  }
  if (!has_pose && verdict.status != Status::kPureRotation) return verdict;
  const bool is_on_one_side =
      e.displaced_rejection >= kRotationRejected && e.rotation_rejection < kRotationRejected;
  if (!has_pose && is_on_one_side) {
    warn(WarningCode::kDisplaced, e.num_displaced, e.rotation_support);
  }
  if (e.num_contradicting > 0) warn(WarningCode::kOneSide, e.num_contradicting, e.support);
  if (has_pose && e.parallax < kCertainParallax * e.scale) {
    warn(WarningCode::kLittleParallax, e.parallax, e.scale);
  }
  if (covers_little(e)) {
    warn(WarningCode::kPartialCoverage, e.coverage, e.match_coverage);
  }
  if (has_pose && e.tilt > kTiltRejected * e.tilt_sigma) {
    warn(WarningCode::kAgainstGravity, e.tilt, e.tilt_sigma);
  }
  if (verdict.status == Status::kOk && is_too_noisy(e)) {
    warn(WarningCode::kMuchNoise, e.noise, e.max_noise);
  }
  return verdict;
}

}  // namespace epi360
