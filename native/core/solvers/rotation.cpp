// SPDX-License-Identifier: BSD-3-Clause
#include "core/solvers/rotation.h"
#include "core/bearings.h"
#include "core/solvers/dense.h"

namespace epi360 {
namespace {

// Orthonormal frame of two directions: bisector, normal and their product.
bool frame_of(const Eigen::Vector3d& a, const Eigen::Vector3d& b, Eigen::Matrix3d* frame) {
  const Eigen::Vector3d normal = a.cross(b);
  const Eigen::Vector3d middle = a + b;
  const double length = normal.norm(), width = middle.norm();
  if (length < 1e-3 || width < 1e-3) return false;  // (anti)parallel: the frame is undefined
  frame->col(0) = middle / width;
  frame->col(1) = normal / length;
  frame->col(2) = frame->col(0).cross(frame->col(1));
  return true;
}

}  // namespace

Eigen::Matrix3d align_rotations(const Matches& m, const double* weights) {
  Eigen::Matrix3d S = Eigen::Matrix3d::Zero();  // sum w b1 b2^T
  for (std::size_t i = 0; i < m.size; ++i) {
    const Eigen::Vector3d b1 = view1(m, i), b2 = view2(m, i);
    S += weights[i] * b1 * b2.transpose();
  }
  Eigen::Matrix4d K;
  K << S.trace(), S(1, 2) - S(2, 1), S(2, 0) - S(0, 2), S(0, 1) - S(1, 0),   //
      0, S(0, 0) - S(1, 1) - S(2, 2), S(0, 1) + S(1, 0), S(0, 2) + S(2, 0),  //
      0, 0, S(1, 1) - S(0, 0) - S(2, 2), S(1, 2) + S(2, 1),                  //
      0, 0, 0, S(2, 2) - S(0, 0) - S(1, 1);
  K.triangularView<Eigen::StrictlyLower>() = K.transpose();
  const Eigen::Vector4d q = symmetric_eigenvectors(K).col(3);
  return Eigen::Quaterniond(q[0], q[1], q[2], q[3]).normalized().toRotationMatrix();
}

bool rotation_of_two(const Eigen::Vector3d& a1, const Eigen::Vector3d& b1,
                     const Eigen::Vector3d& a2, const Eigen::Vector3d& b2, Eigen::Matrix3d* R) {
  Eigen::Matrix3d frame1, frame2;
  if (!frame_of(a1, a2, &frame1) || !frame_of(b1, b2, &frame2)) return false;
  *R = frame2 * frame1.transpose();
  return true;
}

}  // namespace epi360
