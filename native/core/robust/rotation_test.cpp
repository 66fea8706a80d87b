// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/rotation_test.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "core/bearings.h"
#include "core/constants.h"
#include "core/residuals/residuals.h"
#include "core/robust/around_camera.h"
#include "core/robust/neighbourhoods.h"
#include "core/solvers/rotation.h"

namespace epi360 {
namespace {

constexpr int kAlignments = 6;         // steps of a robust fit
constexpr double kMostSquares = 13.8;  // one in a thousand of chi^2 with two degrees of freedom
constexpr double kRayleighMedian = 1.17741, kRayleighMedianError = 0.84932;  // of n: over sqrt n
// Matches that a rotation leaves displaced, by more gates than this. Of those that are displaced by
// no more than the second number, where hardly any wrong match is, so many must agree with a pose.
constexpr double kDisplaced = 2.0, kNearRotation = 10.0 * kDegree, kMostlyAlong = 0.6;
constexpr double kDirectionUnknowns = 2.0;  // of a translation
constexpr std::size_t kFewestDisplaced = 6;

// Residuals of all matches under the rotation that fits the inliers best, near misses left aside
// (Geman-McClure), from that which explains most matches on; none if fewer than three matches are
// inliers.
std::vector<double> residuals_without_translation(const Matches& m,
                                                  const std::vector<unsigned char>& inlier,
                                                  const Eigen::Matrix3d& start, double sigma) {
  double count = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) count += inlier[i] ? m.weight[i] : 0.0;
  if (count < 3.0) return {};
  std::vector<double> weights(m.padded, 0.0), residuals(m.padded);
  Eigen::Matrix<double, 3, 3, Eigen::RowMajor> R = start;
  compute_rotation_residuals(m, R.data(), residuals.data());
  for (int round = 0; round < kAlignments; ++round) {
    for (std::size_t i = 0; i < m.size; ++i) {
      if (!inlier[i]) continue;
      const double ratio = 1.0 + residuals[i] * residuals[i] / (kMostSquares * sigma * sigma);
      weights[i] = m.weight[i] / (ratio * ratio);
    }
    R = align_rotations(m, weights.data());
    compute_rotation_residuals(m, R.data(), residuals.data());
  }
  return residuals;
}

// Standard deviations by which the median angle of some inliers exceeds what noise makes of it.
double rejection_by_median(const Matches& m, const std::vector<std::size_t>& some,
                           const std::vector<double>& residuals, double sigma,
                           const NeighbourErrors& errors) {
  double count = 0.0;
  std::vector<std::pair<double, double>> angles;  // and their weights
  for (const std::size_t i : some) {
    angles.emplace_back(residuals[i], m.weight[i]);
    count += m.weight[i];
  }
  std::sort(angles.begin(), angles.end());
  auto middle = angles.begin();
  for (double below = middle->second; 2.0 * below <= count && middle + 1 != angles.end();) {
    below += (++middle)->second;
  }
  // Angles over sqrt 2 have two components of the noise: a Rayleigh distribution. The scale comes
  // from the same inliers and has an error of its own.
  const double error = std::hypot(kRayleighMedianError, kRayleighMedian / std::sqrt(2.0));
  const double expected = kRayleighMedian * std::sqrt(1.0 + errors.hidden);
  return (middle->first / sigma - expected) / (error / std::sqrt(errors.independent * count));
}

// Standard deviations by which displaced inliers lie on the epipolar curves more often
// than displacements in any direction; none where too few of what is displaced lies on them.
std::optional<double> rejection_by_displaced(const Matches& m,
                                             const std::vector<unsigned char>& inlier,
                                             const std::vector<double>& residuals, double gate,
                                             double least, const NeighbourErrors& errors) {
  const std::vector<double> votes = region_weights(m);
  double displaced = 0.0, agreeing = 0.0, expected = kDirectionUnknowns, variance = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!(residuals[i] > least && residuals[i] < kNearRotation)) continue;
    const double by_chance = std::asin(std::min(gate / residuals[i], 1.0)) / kPi;
    displaced += votes[i];
    agreeing += votes[i] * inlier[i];
    expected += votes[i] * by_chance;
    variance += votes[i] * by_chance * (1.0 - by_chance);
  }
  if (agreeing < kMostlyAlong * displaced) return std::nullopt;
  return (agreeing - expected) * std::sqrt(errors.independent / std::max(variance, 1.0));
}

}  // namespace

RotationTest test_rotation(const Matches& m, const std::vector<unsigned char>& inlier,
                           const Eigen::Matrix3d& rotation, double scale, double gate,
                           const NeighbourErrors& errors) {
  const double sigma = std::max(scale, m.least_scale);
  const std::vector<double> residuals = residuals_without_translation(m, inlier, rotation, sigma);
  RotationTest test;
  if (residuals.empty()) return test;
  const double least = kDisplaced * gate * std::sqrt(1.0 + 2.0 * errors.hidden);
  std::vector<std::size_t> all, displaced, still;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!inlier[i]) continue;
    all.push_back(i);
    (residuals[i] > least ? displaced : still).push_back(i);
  }
  bool passes = false;
  if (displaced.size() >= kFewestDisplaced) {
    const bool all_around = are_all_around(m, displaced);
    passes = !all_around && surround(m, still);
    if (const auto found = rejection_by_displaced(m, inlier, residuals, gate, least, errors)) {
      test.num_displaced = static_cast<int>(displaced.size());
      test.by_displaced = *found;
      test.all_around = all_around;
    }
  }
  test.by_median = rejection_by_median(m, passes ? still : all, residuals, sigma, errors);
  return test;
}

}  // namespace epi360
