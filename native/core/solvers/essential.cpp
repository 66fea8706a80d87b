// SPDX-License-Identifier: BSD-3-Clause
#include "core/solvers/essential.h"

#include <Eigen/SVD>

#include "core/solvers/svd3.h"

namespace epi360 {
namespace {

Eigen::Matrix3d orthonormalised(const Eigen::Matrix3d& R) {
  return Eigen::Quaterniond(R).normalized().toRotationMatrix();
}

}  // namespace

EssentialFactors factors_of(const Eigen::Matrix3d& E) {
  EssentialFactors f;
  // t spans the left null space: the longest cross product of two columns.
  f.t = E.col(0).cross(E.col(1));
  for (int k = 1; k < 3; ++k) {
    const Eigen::Vector3d candidate = E.col(k).cross(E.col((k + 1) % 3));
    if (candidate.squaredNorm() > f.t.squaredNorm()) f.t = candidate;
  }
  f.t.normalize();
  const Eigen::Matrix3d cofactor = cofactors(E);
  const Eigen::Matrix3d tE = skew(f.t) * E;
  f.R[0] = cofactor - tE;
  f.R[1] = cofactor + tE;
  return f;
}

std::array<RelativePose, 4> decompose_essential(const Eigen::Matrix3d& E) {
  const EssentialFactors f = factors_of(E);
  const Eigen::Matrix3d R1 = orthonormalised(f.R[0]), R2 = orthonormalised(f.R[1]);
  return {{{R1, f.t}, {R1, -f.t}, {R2, f.t}, {R2, -f.t}}};
}

Eigen::Matrix3d project_to_essential(const Eigen::Matrix3d& E) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(E, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Vector3d singular(1.0, 1.0, 0.0);
  return svd.matrixU() * singular.asDiagonal() * svd.matrixV().transpose();
}

}  // namespace epi360
