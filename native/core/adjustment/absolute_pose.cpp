// SPDX-License-Identifier: BSD-3-Clause
#include "core/adjustment/absolute_pose.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/adjustment/pose_scores.h"
#include "core/adjustment/window.h"
#include "core/robust/ransac.h"

namespace epi360 {
namespace {

constexpr double kMedianLength = 1.1774100225154747;  // of a standard normal vector in the plane
constexpr double kLossScale = 2.0;                    // of Cauchy's loss, in units of the noise
constexpr double kSmallestLossScale = 1e-7;           // radians
constexpr double kAgreement = 0.5;  // share of inliers from which a guess needs no samples
constexpr int kLocalSteps = 4, kStageSteps = 6, kLastSteps = 15;
const LoopOptions kLoop{20, 2000, 0.999};

using RowMatrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

// For the RANSAC loop, and by itself to refine a guess.
class AbsoluteProblem {
 public:
  using Model = AbsolutePose;
  static constexpr int kMaxModels = 4;

  AbsoluteProblem(const double* bearings, const double* points, std::size_t n,
                  const AbsolutePoseOptions& options)
      : options_(options),
        gate_(2.0 * std::sin(0.5 * options.threshold)),
        seen_(bearings, points, n),
        lengths_(n) {
    window_.rotations.resize(9);
    window_.translations.resize(3);
    window_.points.assign(points, points + 3 * n);
    window_.bearings.assign(bearings, bearings + 3 * n);
    window_.free_frame = {1};
    window_.frame.assign(n, 0);
    window_.weights.assign(n, 1.0);
    for (std::size_t i = 0; i < n; ++i) window_.point.push_back(static_cast<std::uint32_t>(i));
    if (!options.has_gravity) return;
    window_.gravity.assign(options.gravity.data(), options.gravity.data() + 3);
    window_.gravity_weights = {1.0 / (options.gravity_sigma * options.gravity_sigma)};
    std::copy_n(options.world_gravity.data(), 3, window_.world_gravity);
  }

  int sample_size() const { return 3; }

  int generate(const std::uint32_t* sample, AbsolutePose* models) const {
    Eigen::Matrix3d bearings, points;
    for (int k = 0; k < 3; ++k) {
      bearings.col(k) = Eigen::Map<const Eigen::Vector3d>(&window_.bearings[3 * sample[k]]);
      points.col(k) = Eigen::Map<const Eigen::Vector3d>(&window_.points[3 * sample[k]]);
    }
    return p3p(bearings, points, models);
  }

  double score(const AbsolutePose& pose, double) const { return scored(pose).cost; }
  void refine(AbsolutePose& pose) { descend(pose, 0.5 * options_.threshold, kLocalSteps); }
  std::size_t num_inliers(const AbsolutePose& pose) const { return scored(pose).num_inliers; }

  double inlier_share(const AbsolutePose& pose) const {
    return static_cast<double>(num_inliers(pose)) / static_cast<double>(seen_.size);
  }

  // From a pose that may be far off: losses that become narrower until they are half the
  // threshold wide. Where most matches are wrong, they lead away from a pose that is near.
  void approach(AbsolutePose& pose) {
    const double narrowest = 0.5 * options_.threshold;
    double scale = std::max(narrowest, median_length(pose, 4.0));
    while (scale > narrowest) {
      descend(pose, scale, kStageSteps);
      scale = std::max(narrowest, std::min(0.5 * scale, median_length(pose, 4.0)));
    }
  }

  // From a pose that is near, by a loss that is half the threshold wide, then by one that suits the
  // noise of the inliers.
  void settle(AbsolutePose& pose) {
    const double narrowest = 0.5 * options_.threshold;
    descend(pose, narrowest, kStageSteps);
    const double noise = median_length(pose, gate_) / kMedianLength;
    descend(pose, std::min(std::max(kLossScale * noise, kSmallestLossScale), narrowest),
            kLastSteps);
  }

 private:
  PoseScore scored(const AbsolutePose& pose) const {
    const RowMatrix3 R = pose.R;
    return pose_score(seen_, R.data(), pose.t.data(), gate_);
  }

  // Median of the chords below a gate; the gate, if there is none.
  double median_length(const AbsolutePose& pose, double gate) {
    const RowMatrix3 R = pose.R;
    chords(seen_, R.data(), pose.t.data(), lengths_.data());
    const auto end = std::partition(lengths_.begin(), lengths_.end(),
                                    [&](double length) { return length < gate; });
    if (end == lengths_.begin()) return gate;
    const auto middle = lengths_.begin() + (end - lengths_.begin()) / 2;
    std::nth_element(lengths_.begin(), middle, end);
    return *middle;
  }

  // Least Cauchy loss of this scale in radians.
  void descend(AbsolutePose& pose, double scale, int max_steps) {
    Eigen::Map<RowMatrix3> R(window_.rotations.data());
    Eigen::Map<Eigen::Vector3d> t(window_.translations.data());
    R = pose.R;
    t = pose.t;
    WindowOptions options;
    options.loss.loss = Loss::kCauchy;
    options.loss.scale = kLossScale;
    options.noise = scale / kLossScale;
    options.max_iterations = max_steps;
    options.points_free = false;
    adjust(window_, options, workspace_);
    pose.R = Eigen::Map<RowMatrix3>(window_.rotations.data());  // adjust may have swapped them
    pose.t = Eigen::Map<Eigen::Vector3d>(window_.translations.data());
  }

  AbsolutePoseOptions options_;
  double gate_;  // the threshold as a chord
  SeenPoints seen_;
  std::vector<double> lengths_;
  Window window_;
  WindowWorkspace workspace_;
};

}  // namespace

std::optional<AbsolutePose> absolute_pose(const double* bearings, const double* points,
                                          std::size_t n, const std::optional<AbsolutePose>& guess,
                                          const AbsolutePoseOptions& options) {
  if (n < std::max<std::size_t>(options.min_num_inliers, 3)) return {};
  AbsoluteProblem problem(bearings, points, n, options);
  LoopResult<AbsolutePose> best;
  if (guess) {
    for (const bool is_far : {true, false}) {
      AbsolutePose pose = *guess;
      if (is_far) problem.approach(pose);
      problem.settle(pose);
      const double score = problem.score(pose, 0.0);
      if (best.found() && score >= best.score) continue;
      best.model = pose;
      best.score = score;
      const std::size_t count = problem.num_inliers(pose);
      if (count >= options.min_num_inliers && count >= kAgreement * static_cast<double>(n)) {
        return best.model;
      }
    }
  }
  Sampler sampler(static_cast<std::uint32_t>(n), 3);
  Random random(options.seed);
  NoPool none;
  ransac(
      problem, sampler, kLoop, random, none,
      [&](const AbsolutePose& pose) { return problem.inlier_share(pose); }, best);
  if (!best.found()) return {};
  problem.settle(best.model);
  return best.model;
}

}  // namespace epi360
