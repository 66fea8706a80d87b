// SPDX-License-Identifier: BSD-3-Clause
// Essential matrix to relative poses; depths along the rays.
#pragma once

#include <array>

#include "core/matches.h"
#include "core/pose.h"

namespace epi360 {

// The four poses (R, t), (R, -t), (R', t), (R', -t) of a valid essential matrix, without an SVD
// (Horn, "Recovering baseline and orientation from essential matrix", 1990).
std::array<RelativePose, 4> decompose_essential(const Eigen::Matrix3d& E);

// Both rotations and the direction of a valid essential matrix; the rotations are orthonormal as
// far as E is essential.
struct EssentialFactors {
  Eigen::Matrix3d R[2];
  Eigen::Vector3d t;
};
EssentialFactors factors_of(const Eigen::Matrix3d& E);

// Nearest matrix with singular values (1, 1, 0).
Eigen::Matrix3d project_to_essential(const Eigen::Matrix3d& E);

// Two numbers with the signs of the depths of one match; where one is negative, it is the parallax
// (radians) of the wrong sign. Depth 1 has the sign of (a x b).(b x t) and depth 2 that of
// (a x b).(a x t), with a = R b1, b = b2.
struct DepthMargins {
  double first, second;
};

inline DepthMargins depth_margins(const RelativePose& pose, const Eigen::Vector3d& b1,
                                  const Eigen::Vector3d& b2) {
  const Eigen::Vector3d a = pose.R * b1;
  const double c = a.dot(b2), ta = pose.t.dot(a), tb = pose.t.dot(b2);
  return {c * tb - ta, tb - c * ta};
}

// Whether both depths are positive for one match, up to a parallax of `tolerance`.
inline bool is_in_front(const RelativePose& pose, const Eigen::Vector3d& b1,
                        const Eigen::Vector3d& b2, double tolerance) {
  const DepthMargins d = depth_margins(pose, b1, b2);
  return d.first > -tolerance && d.second > -tolerance;
}

}  // namespace epi360
