// SPDX-License-Identifier: BSD-3-Clause
// Pose of three points (Persson & Nordberg, "Lambda Twist", ECCV 2018).
#pragma once

#include <Eigen/Core>

namespace epi360 {

// cam_from_world: x = R X + t, in the unit of the world.
struct AbsolutePose {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Vector3d t = Eigen::Vector3d::Zero();
};

// Poses that put each point (column) on the ray of its unit bearing, anywhere on the sphere.
// Returns their number, at most four.
int p3p(const Eigen::Matrix3d& bearings, const Eigen::Matrix3d& points, AbsolutePose* poses);

}  // namespace epi360
