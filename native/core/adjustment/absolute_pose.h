// SPDX-License-Identifier: BSD-3-Clause
// Robust pose of a camera that sees points in known places.
#pragma once

#include <cstdint>
#include <optional>

#include "core/solvers/p3p.h"

namespace epi360 {

struct AbsolutePoseOptions {
  double threshold = 0.01;  // radians: the largest angle of an inlier
  std::size_t min_num_inliers = 10;
  std::uint64_t seed = 0;
  bool has_gravity = false;
  Eigen::Vector3d gravity = Eigen::Vector3d::UnitY();  // in the camera
  Eigen::Vector3d world_gravity = Eigen::Vector3d::UnitY();
  double gravity_sigma = 0.02;  // radians, per axis
};

// bearings and points: (n, 3) row-major, without NaN, the bearings of unit length. Samples are
// drawn only where the guess does not lead to a pose that half of the points agree with.
std::optional<AbsolutePose> absolute_pose(const double* bearings, const double* points,
                                          std::size_t n, const std::optional<AbsolutePose>& guess,
                                          const AbsolutePoseOptions& options);

}  // namespace epi360
