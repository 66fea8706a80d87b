// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/inliers.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/bearings.h"
#include "core/robust/evidence.h"
#include "core/solvers/essential.h"

namespace epi360 {
namespace {

// When a pose without depths takes the place of the best candidate: how far apart they are, and
// what share of its inliers and parallax it has.
constexpr double kReleased = 2.0 * kDegree, kReleasedSupport = 0.8, kReleasedParallax = 0.9;
// In noise: with less parallax than that a pose is a rotation, whose direction means nothing.
constexpr double kLeastReleased = 2.5;
constexpr double kReleasedEvidence = 60.0;  // how much less likely the candidate behind it may be
constexpr double kClearlyBehind = 3.0;      // gates of parallax

}  // namespace

void decide_cheirality(const Matches& m, const std::vector<unsigned char>& inlier,
                       RelativePose& pose) {
  const Eigen::Matrix3d half_turn = 2.0 * pose.t * pose.t.transpose() - Eigen::Matrix3d::Identity();
  const RelativePose variants[4] = {
      pose, {pose.R, -pose.t}, {half_turn * pose.R, pose.t}, {half_turn * pose.R, -pose.t}};
  double best = -1.0;
  for (const RelativePose& variant : variants) {
    double count = 0.0;
    for (std::size_t i = 0; i < m.size; ++i) {
      if (!inlier[i]) continue;
      const Eigen::Vector3d b1 = view1(m, i), b2 = view2(m, i);
      count += is_in_front(variant, b1, b2, 0.0);
    }
    if (count > best) {
      best = count;
      pose = variant;
    }
  }
}

double mark_inliers(const Matches& m, Residual residual, const RelativePose& pose, double gate,
                    bool use_depths, std::vector<unsigned char>& inlier,
                    std::vector<double>& residuals, double* behind) {
  std::vector<double> margins(m.padded);
  residuals.resize(m.padded);
  compute_residuals(m, residual, plain(pose), residuals.data(), margins.data());
  const double tolerance = std::min(gate, kLargestWrongParallax);
  inlier.assign(m.size, 0);
  double weight = 0.0, weight_behind = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    const bool fits = std::abs(residuals[i]) < gate;
    const bool agrees = fits & (!use_depths | (margins[i] > -tolerance));
    inlier[i] = agrees;
    weight += agrees * m.weight[i];
    weight_behind += (fits & (margins[i] < -kClearlyBehind * gate)) * m.weight[i];
  }
  if (behind) *behind = weight_behind;
  return weight;
}

double weight_of_mirrored_turn(const Matches& m, const RelativePose& pose, double gate) {
  const Eigen::Matrix3d mirror = Eigen::Matrix3d::Identity() - 2.0 * pose.t * pose.t.transpose();
  const double near = 2.0 * gate * gate;  // squared, as residuals of rotations are measured
  const double apart = kClearlyBehind * kClearlyBehind * near;
  double weight = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    const Eigen::Vector3d turned = pose.R * view1(m, i), b2 = view2(m, i);
    const bool fits = (mirror * turned - b2).squaredNorm() < near;
    const bool has_moved = (turned - b2).squaredNorm() > apart;
    const bool is_behind = pose.t.dot(turned) > 0.0;
    weight += (fits & has_moved & is_behind) * m.weight[i];
  }
  return weight;
}

void release_depths(const Matches& m, Residual residual, Candidates& candidates) {
  if (candidates.empty()) return;
  const std::vector<Candidate> all = candidates.all();
  const Candidate& best = all.front();
  const double gate = gate_of(best.loss);
  std::vector<unsigned char> inlier;
  std::vector<double> residuals;
  double support = -1.0, parallax = 0.0;  // of the best, which few need
  double most = -std::numeric_limits<double>::infinity();
  for (const Candidate& c : all) {
    if (c.evidence < best.evidence - kReleasedEvidence) break;
    if (c.evidence > best.evidence) continue;  // was put behind the best for another reason
    Candidate released = candidates.without_depths(c);
    if (released.evidence < most ||
        same_pose(best.cam2_from_cam1, released.cam2_from_cam1, kReleased, 2.0 * kReleased)) {
      most = std::max(most, released.evidence);
      continue;
    }
    if (support < 0.0) {
      support = mark_inliers(m, residual, best.cam2_from_cam1, gate, true, inlier, residuals);
      parallax = median_parallax(m, best.cam2_from_cam1, inlier.data());
    }
    mark_inliers(m, residual, released.cam2_from_cam1, gate, false, inlier, residuals);
    decide_cheirality(m, inlier, released.cam2_from_cam1);
    const double kept =
        mark_inliers(m, residual, released.cam2_from_cam1, gate, true, inlier, residuals);
    if (kept < kReleasedSupport * support) continue;
    const double released_parallax = median_parallax(m, released.cam2_from_cam1, inlier.data());
    if (!(released_parallax < kReleasedParallax * parallax)) continue;
    if (!(released_parallax > kLeastReleased * released.loss.scale)) continue;
    most = released.evidence;
    released.evidence = best.evidence;
    candidates.replace_best(released);
  }
}

}  // namespace epi360
