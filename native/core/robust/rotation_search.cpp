// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/rotation_search.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/bearings.h"
#include "core/constants.h"
#include "core/residuals/residuals.h"
#include "core/robust/ransac.h"
#include "core/solvers/rotation.h"

namespace epi360 {
namespace {

constexpr double kRotationNear = 0.35;  // of the inliers, near a rotation: worth a search

}  // namespace

RotationProblem::RotationProblem(const Matches& m, std::vector<double> gates)
    : m_(m), gates_(std::move(gates)), residuals_(m.padded), weights_(m.padded) {}

int RotationProblem::generate(const std::uint32_t* sample, Model* models) const {
  return rotation_of_two(view1(m_, sample[0]), view2(m_, sample[0]), view1(m_, sample[1]),
                         view2(m_, sample[1]), models);
}

double RotationProblem::score(const Model& R, double limit) const {
  const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rows = R;
  return truncated_rotation_score(m_, rows.data(), gates_.data(), static_cast<int>(gates_.size()),
                                  limit);
}

void RotationProblem::refine(Model& R) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  double best = score(R, kInfinity);
  Model current = R;
  for (int k = static_cast<int>(gates_.size()) - 1; k >= 0; --k) {
    for (int repeat = 0; repeat < 2; ++repeat) {
      if (count_within(current, gates_[k]) < 3.0) continue;
      for (std::size_t i = 0; i < m_.padded; ++i) {
        weights_[i] = residuals_[i] < gates_[k] ? m_.weight[i] : 0.0;
      }
      current = align_rotations(m_, weights_.data());
    }
    const double value = score(current, kInfinity);
    if (value < best) {
      best = value;
      R = current;
    }
  }
}

double RotationProblem::inlier_share(const Model& R) {
  double total = 0.0;
  for (std::size_t i = 0; i < m_.size; ++i) total += m_.weight[i];
  return total > 0.0 ? count_within(R, gates_.back()) / total : 0.0;
}

double RotationProblem::count_within(const Model& R, double gate) {
  const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rows = R;
  compute_rotation_residuals(m_, rows.data(), residuals_.data());
  double count = 0.0;
  for (std::size_t i = 0; i < m_.size; ++i) count += residuals_[i] < gate ? m_.weight[i] : 0.0;
  return count;
}

RotationFit best_rotation(const Matches& m, double gate, Random& random) {
  RotationProblem problem(m, {gate, 1.5 * gate, 2.2 * gate, 3.0 * gate});
  const LoopOptions loop{20, 500, 0.999};
  LoopResult<Eigen::Matrix3d> result;
  result.model.setIdentity();
  Sampler sampler(static_cast<std::uint32_t>(m.size), problem.sample_size());
  NoPool none;
  ransac(
      problem, sampler, loop, random, none,
      [&](const Eigen::Matrix3d& R) { return problem.inlier_share(R); }, result);
  RotationFit fit;
  // Samples of nearly equal bearings fix no rotation; all of them together may.
  fit.R = result.found() ? result.model : align_rotations(m, m.weight.data());
  fit.support = static_cast<int>(std::lround(problem.count_within(fit.R, gate)));
  fit.residuals = problem.residuals();
  fit.residuals.resize(m.size);
  return fit;
}

bool rotation_possible(const Matches& m, const std::vector<unsigned char>& inlier, int support,
                       double gate, Random& random) {
  std::vector<std::uint32_t> chosen;
  double total = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    total += m.weight[i];
    if (inlier[i]) chosen.push_back(static_cast<std::uint32_t>(i));
  }
  if (support < 10) return true;
  const double wide = 3.0 * gate, limit = total - kRotationNear * support;
  int tried = 0;
  for (int round = 0; round < 20; ++round) {
    std::uint32_t pick[2];
    random.distinct(static_cast<std::uint32_t>(chosen.size()), 2, pick);
    const std::uint32_t i = chosen[pick[0]], j = chosen[pick[1]];
    Eigen::Matrix3d R;
    if (!rotation_of_two(view1(m, i), view2(m, i), view1(m, j), view2(m, j), &R)) continue;
    ++tried;
    const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rows = R;
    if (truncated_rotation_score(m, rows.data(), &wide, 1, limit) < limit) return true;
  }
  return tried < 10;  // nearly equal bearings fix no rotation
}

}  // namespace epi360
