// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/around_camera.h"

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <algorithm>

#include "core/bearings.h"

namespace epi360 {
namespace {

// Share outside any hemisphere, counted on so many: one always holds four of five.
constexpr double kOutsideHemisphere = 0.1;
constexpr std::size_t kMostAround = 64;
constexpr double kLeastSpread = 0.08;  // mean square of the sines of angles to any plane

// Share of the bearings outside the hemisphere that holds most of them: its boundary can be moved
// until it goes through two of them.
double share_outside_hemisphere(const std::vector<Eigen::Vector3d>& bearings) {
  const std::size_t n = bearings.size();
  if (n < 2) return 0.0;
  std::size_t most = 0;
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = i + 1; j < n; ++j) {
      const Eigen::Vector3d pole = bearings[i].cross(bearings[j]);
      std::size_t above = 0, below = 0;
      for (std::size_t k = 0; k < n; ++k) {
        if (k == i || k == j) continue;
        const double height = pole.dot(bearings[k]);
        above += height > 0.0;
        below += height < 0.0;
      }
      most = std::max({most, above + 2, below + 2});
    }
  }
  return 1.0 - static_cast<double>(most) / static_cast<double>(n);
}

}  // namespace

bool are_all_around(const Matches& m, const std::vector<std::size_t>& chosen) {
  const std::size_t count = std::min(chosen.size(), kMostAround);
  for (const auto view : {view1, view2}) {
    std::vector<Eigen::Vector3d> bearings;
    for (std::size_t k = 0; k < count; ++k) {
      bearings.push_back(view(m, chosen[k * chosen.size() / count]));
    }
    if (share_outside_hemisphere(bearings) < kOutsideHemisphere) return false;
  }
  return true;
}

bool surround(const Matches& m, const std::vector<std::size_t>& chosen) {
  for (const auto view : {view1, view2}) {
    Eigen::Matrix3d moments = Eigen::Matrix3d::Zero();
    for (const std::size_t i : chosen) moments += view(m, i) * view(m, i).transpose();
    moments /= std::max(static_cast<double>(chosen.size()), 1.0);
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(moments, Eigen::EigenvaluesOnly);
    if (!(solver.eigenvalues()[0] > kLeastSpread)) return false;
  }
  return are_all_around(m, chosen);
}

}  // namespace epi360
