// SPDX-License-Identifier: BSD-3-Clause
// A relative pose and the few Lie-group helpers around it.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

namespace epi360 {

// cam2_from_cam1: x2 = R x1 + t, |t| = 1.
struct RelativePose {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Vector3d t = Eigen::Vector3d::UnitZ();
};

inline Eigen::Matrix3d skew(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

inline Eigen::Matrix3d exp_so3(const Eigen::Vector3d& w) {
  const double angle = w.norm();
  if (angle < 1e-12) return Eigen::Matrix3d::Identity() + skew(w);
  return Eigen::AngleAxisd(angle, w / angle).toRotationMatrix();
}

// Two unit vectors that complete t to an orthonormal basis; a smooth rule, the same in Python:
// the coordinate axis least aligned with t is projected and normalised.
inline Eigen::Matrix<double, 3, 2> tangent_basis(const Eigen::Vector3d& t) {
  int axis = 0;
  for (int k = 1; k < 3; ++k) {
    if (std::abs(t[k]) < std::abs(t[axis])) axis = k;
  }
  Eigen::Vector3d first = Eigen::Vector3d::Unit(axis) - t[axis] * t;
  first.normalize();
  Eigen::Matrix<double, 3, 2> basis;
  basis << first, t.cross(first);
  return basis;
}

inline double rotation_angle(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b) {
  const Eigen::Matrix3d d = a.transpose() * b;
  const Eigen::Vector3d axis(d(2, 1) - d(1, 2), d(0, 2) - d(2, 0), d(1, 0) - d(0, 1));
  return std::atan2(axis.norm(), d.trace() - 1.0);
}

inline double direction_angle(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

// Whether two poses are so close that they are one hypothesis.
inline bool same_pose(const RelativePose& a, const RelativePose& b, double rotation_rad,
                      double direction_rad) {
  return rotation_angle(a.R, b.R) < rotation_rad && direction_angle(a.t, b.t) < direction_rad;
}

}  // namespace epi360
