// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/displacement.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "core/bearings.h"
#include "core/constants.h"
#include "core/refinement/fit_mixture.h"
#include "core/refinement/mixture.h"
#include "core/solvers/rotation.h"

namespace epi360 {
namespace {

constexpr std::size_t kMostAligned = 128;  // matches that tell the rotation
// Scales of the Geman-McClure loss, from one that forgets no match to one of what stands near by.
constexpr double kFromScale = 60.0 * kDegree, kToScale = 3.0 * kDegree, kNarrowing = 0.6;
constexpr int kShareRounds = 3;                       // of expectation maximisation
constexpr double kReachOfChance = 4.442882938158366;  // sqrt(2) pi: see displacement.h
constexpr double kNearest = 1.0 * kDegree;            // no wrong partner is expected nearer

// The rotation that most matches are near (graduated non-convexity).
Eigen::Matrix3d common_rotation(const Matches& m) {
  std::vector<std::size_t> rows;
  const std::size_t step = std::max<std::size_t>(1, m.size / kMostAligned);
  for (std::size_t i = 0; i < m.size; i += step) rows.push_back(i);
  const Matches some = chosen_matches(m, rows);
  std::vector<double> weights = some.weight;
  Eigen::Matrix3d R = align_rotations(some, weights.data());
  for (double scale = kFromScale; scale > kToScale; scale *= kNarrowing) {
    for (std::size_t i = 0; i < some.size; ++i) {
      const double chord = (R * view1(some, i) - view2(some, i)).norm() / scale;
      const double ratio = 1.0 + chord * chord;
      weights[i] = some.weight[i] / (ratio * ratio);
    }
    R = align_rotations(some, weights.data());
  }
  return R;
}

}  // namespace

std::vector<double> displacements(const Matches& m) {
  const Eigen::Matrix3d R = common_rotation(m);
  std::vector<double> sines(m.padded);
  for (std::size_t i = 0; i < m.padded; ++i) {
    const Eigen::Vector3d b1 = view1(m, i), b2 = view2(m, i);
    sines[i] = std::min((R * b1).cross(b2).norm(), b1.cross(b2).norm());
  }
  return sines;
}

double log_odds_over_chance(const Matches& m, const std::vector<double>& displaced,
                            const double* residuals, const double* margins, double depth_tolerance,
                            const LossModel& mixture) {
  // Chance is no rarer than right matches in the middle of the noise, where a displacement says
  // nothing, and no more than for partners from anywhere.
  const double shortest = std::max(mixture.scale / kInverseRootTwoPi, kReachOfChance * kNearest);
  const double longest = 1.0 / mixture.outlier_density;
  std::vector<double> reach(m.padded), weights(m.padded);
  for (std::size_t i = 0; i < m.padded; ++i) {
    reach[i] = std::min(std::max(kReachOfChance * displaced[i], shortest), longest);
  }
  LossModel fitted = mixture;
  double log_odds = 0.0;
  for (int round = 0; round < kShareRounds; ++round) {
    const MixtureSums sums = mixture_pass_over_chance(m, residuals, margins, depth_tolerance,
                                                      reach.data(), fitted, weights.data());
    log_odds = sums.log_likelihood;
    set_shares(sums.part, sums.count, fitted);
  }
  return log_odds;
}

}  // namespace epi360
