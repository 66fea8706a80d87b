// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/estimate.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/robust/covariance.h"
#include "core/robust/evidence.h"
#include "core/robust/inliers.h"
#include "core/robust/leverage.h"
#include "core/robust/rival.h"
#include "core/robust/rotation_search.h"
#include "core/robust/search.h"

namespace epi360 {
namespace {

constexpr double kWrongGravity = 15.0 * kDegree;

// The estimate of one set of matches, from its search to its verdict.
class Estimate {
 public:
  Estimate(const Matches& m, const RobustOptions& options, const MatchPriors& priors,
           std::uint64_t seed)
      : m_(m), options_(options), random_(seed), seed_(seed) {
    result_.inlier.assign(m.size, 0);
    result_.residuals.assign(m.padded, RobustResult::kNaN);
    result_.covariance.setConstant(RobustResult::kNaN);
    if (options.threshold > 0.0) result_.threshold = options.threshold;
    Evidence& evidence = result_.evidence;
    evidence.num_usable = static_cast<int>(m.size);
    evidence.sample_size = options.sample_size;
    if (status() == Status::kTooFewMatches) return;
    SearchResult found = search_poses(m, options, priors, random_);
    result_.num_iterations = found.num_iterations;
    release_depths(m, options.residual, found.candidates);
    found.candidates.simplify();
    dropped_ = drop_leverage(m, options.residual, found.candidates);
    assess(found.candidates);
  }

  RobustResult take() { return std::move(result_); }

 private:
  Status status() const { return judge(result_.evidence).status; }

  // Inliers, evidence and uncertainty of the best candidate, or of a rotation in its place.
  void assess(Candidates& candidates) {
    mark(candidates);
    Evidence& evidence = result_.evidence;
    const double gate = result_.threshold;
    const ChanceDensity chance(m_, options_.residual, seed_);
    RotationFit rotation;
    if (candidates.empty() ||
        rotation_possible(m_, result_.inlier, evidence.support, gate, random_)) {
      rotation = best_rotation(m_, gate, random_);
      evidence.rotation_support = rotation.support;
      evidence.rotation_log10_false_alarms =
          log10_false_alarms(evidence.num_usable, rotation.support,
                             chance.rotation_share(rotation.R, gate), kRotationSample);
    }
    if (status() == Status::kPureRotation) return set_rotation(std::move(rotation));
    const double density = candidates.empty()
                               ? kTypicalDensity
                               : chance.at(result_.cam2_from_cam1, std::max(kDegree, gate));
    evidence.chance = 2.0 * gate * density;
    evidence.log10_false_alarms = log10_false_alarms(evidence.num_usable, evidence.support,
                                                     evidence.chance, options_.sample_size);
    if (status() == Status::kTooFewInliers) return;
    const Uncertainty uncertainty =
        pose_uncertainty(m_, options_.residual, result_.cam2_from_cam1, candidates.best().loss,
                         gate, result_.inlier, dropped_, result_.residuals);
    result_.scale = evidence.scale = uncertainty.scale;
    result_.covariance = uncertainty.covariance;
    evidence.parallax = median_parallax(m_, result_.cam2_from_cam1, result_.inlier.data());
    result_.parallax = evidence.parallax;
    if (has_hardly_any_parallax(evidence)) {
      if (rotation.support == 0) rotation = best_rotation(m_, gate, random_);
      evidence.rotation_support = rotation.support;
      if (status() == Status::kPureRotation) return set_rotation(std::move(rotation));
    }
    const Rival rival = find_rival(m_, candidates, result_.cam2_from_cam1, uncertainty.covariance,
                                   result_.inlier, gate);
    evidence.has_twin = rival.has_twin;
    if (!rival.cam2_from_cam1) return;
    evidence.rival_evidence = rival.evidence;
    if (status() == Status::kPlanarAmbiguous) result_.alternatives = {*rival.cam2_from_cam1};
  }

  // The pose of the best candidate, its gate and its inliers.
  void mark(const Candidates& candidates) {
    RobustResult& r = result_;
    if (!(options_.threshold > 0.0)) {
      r.threshold = candidates.empty() ? default_gate() : estimated_gate(candidates.best().loss);
    }
    if (candidates.empty()) return;
    r.cam2_from_cam1 = candidates.best().cam2_from_cam1;
    const auto inliers = [&](bool use_depths) {
      return mark_inliers(m_, options_.residual, r.cam2_from_cam1, r.threshold, use_depths,
                          r.inlier, r.residuals);
    };
    inliers(false);
    decide_cheirality(m_, r.inlier, r.cam2_from_cam1);
    r.evidence.support = inliers(true);
    for (std::size_t i = 0; i < m_.size; ++i) {
      r.evidence.support -= r.inlier[i] && dropped_[i];
      r.inlier[i] = r.inlier[i] && !dropped_[i];
    }
  }

  void set_rotation(RotationFit rotation) {
    RobustResult& r = result_;
    r.cam2_from_cam1 = {rotation.R, Eigen::Vector3d::UnitZ()};
    r.residuals = std::move(rotation.residuals);
    for (std::size_t i = 0; i < m_.size; ++i) r.inlier[i] = r.residuals[i] < r.threshold;
    const Uncertainty uncertainty = rotation_uncertainty(m_, r.inlier, r.residuals);
    r.scale = uncertainty.scale;
    r.covariance = uncertainty.covariance;
    r.parallax = median_parallax(m_, r.cam2_from_cam1, r.inlier.data());
  }

  const Matches& m_;
  const RobustOptions& options_;
  Random random_;
  std::uint64_t seed_;
  std::vector<unsigned char> dropped_;
  RobustResult result_;
};

// Whether a pose was found and turns gravity as it should; otherwise it is searched without.
bool agrees_with_gravity(const RobustResult& result, const MatchPriors& priors) {
  const Status status = judge(result.evidence).status;
  if (status != Status::kOk && status != Status::kPureRotation) return false;
  return direction_angle(result.cam2_from_cam1.R * priors.gravity1, priors.gravity2) <
         kWrongGravity;
}

// The numbers that this status leaves undetermined become NaN.
void clear_undetermined(Status status, RelativePose& cam2_from_cam1) {
  if (has_translation(status)) return;
  cam2_from_cam1.t.setConstant(RobustResult::kNaN);
  if (status != Status::kPureRotation) cam2_from_cam1.R.setConstant(RobustResult::kNaN);
}

// The last evidence, where the inliers are, and the verdict on everything.
void conclude(const Matches& m, const RobustOptions& options, std::size_t num_matches,
              double max_noise, RobustResult& r) {
  Evidence& evidence = r.evidence;
  const Status earlier = judge(evidence).status;
  evidence.num_matches = static_cast<int>(num_matches);
  evidence.min_num_inliers = options.min_num_inliers;
  evidence.num_distinct = count_distinct(m, r.inlier.data());
  evidence.spread = mean_spread(m, r.inlier.data());
  evidence.spread_of_matches = mean_spread(m, nullptr);
  evidence.coverage = sphere_coverage(m, r.inlier.data());
  evidence.match_coverage = sphere_coverage(m, nullptr);
  evidence.noise = r.scale * noise_per_residual(options.residual);
  evidence.max_noise = max_noise;
  r.verdict = judge(evidence);
  const Status status = r.verdict.status;
  r.translation_basis.setConstant(RobustResult::kNaN);
  if (has_translation(status)) r.translation_basis = tangent_basis(r.cam2_from_cam1.t);
  if (!has_translation(status) && status != Status::kPureRotation) {
    r.covariance.setConstant(RobustResult::kNaN);
  }
  if (status == Status::kTooFewInliers) r.alternatives.clear();
  if (status == Status::kConcentratedInliers) {  // what it would have been
    r.alternatives.insert(r.alternatives.begin(), r.cam2_from_cam1);
    clear_undetermined(earlier, r.alternatives.front());
  }
  clear_undetermined(status, r.cam2_from_cam1);
}

}  // namespace

RobustResult estimate_relative_pose(const Matches& m, const RobustOptions& options,
                                    const MatchPriors& priors, std::uint64_t seed,
                                    std::size_t num_matches, double max_noise) {
  RobustResult result = Estimate(m, options, priors, seed).take();
  if (priors.has_gravity && !agrees_with_gravity(result, priors)) {
    MatchPriors free = priors;
    free.has_gravity = false;
    const int num_iterations = result.num_iterations;
    result = Estimate(m, options, free, seed).take();
    result.num_iterations += num_iterations;
  }
  conclude(m, options, num_matches, max_noise, result);
  return result;
}

}  // namespace epi360
