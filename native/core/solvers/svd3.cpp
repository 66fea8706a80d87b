// SPDX-License-Identifier: BSD-3-Clause
#include "core/solvers/svd3.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

namespace epi360 {
namespace {

// Turns columns p and q of W, and of V with it, until those of W are orthogonal. False if they are.
bool orthogonalise(Svd3& svd, int p, int q) {
  const double pp = svd.W.col(p).squaredNorm(), qq = svd.W.col(q).squaredNorm();
  const double pq = svd.W.col(p).dot(svd.W.col(q));
  constexpr double kEpsilon = std::numeric_limits<double>::epsilon();
  if (!(pq * pq > kEpsilon * kEpsilon * pp * qq)) return false;
  const double zeta = 0.5 * (qq - pp) / pq;
  const double root = std::abs(zeta) + std::sqrt(1.0 + zeta * zeta);
  const double tangent = (zeta < 0.0 ? -1.0 : 1.0) / root;
  const double cosine = 1.0 / std::sqrt(1.0 + tangent * tangent), sine = cosine * tangent;
  for (Eigen::Matrix3d* matrix : {&svd.W, &svd.V}) {
    const Eigen::Vector3d first = matrix->col(p), second = matrix->col(q);
    matrix->col(p) = cosine * first - sine * second;
    matrix->col(q) = sine * first + cosine * second;
  }
  return true;
}

void sort_columns(Svd3& svd) {
  const auto order = [&svd](int p, int q) {
    if (svd.lengths[p] >= svd.lengths[q]) return;
    svd.W.col(p).swap(svd.W.col(q));
    svd.V.col(p).swap(svd.V.col(q));
    std::swap(svd.lengths[p], svd.lengths[q]);
  };
  order(0, 1);
  order(1, 2);
  order(0, 1);
}

// Right singular vector of the smallest singular value. The cofactors of M have the same singular
// vectors and the values s2 s3, s1 s3 and s1 s2: the wanted one dominates P = C^T C, and ever more
// its powers. False where s2 and s3 are too close for that.
bool smallest_direction(const Eigen::Matrix3d& M, Eigen::Vector3d* v) {
  const Eigen::Matrix3d C = cofactors(M);
  Eigen::Matrix3d P = C.transpose() * C;
  constexpr int kMaxSquarings = 12;
  for (int k = 0; k < kMaxSquarings; ++k) {
    P *= 1.0 / P.trace();
    if (1.0 - P.squaredNorm() < 2e-16) {  // of rank one: v v^T
      int longest = 0;
      P.diagonal().maxCoeff(&longest);
      *v = P.col(longest).normalized();
      return true;
    }
    P = P * P;
  }
  return false;
}

}  // namespace

Eigen::Matrix3d cofactors(const Eigen::Matrix3d& M) {
  Eigen::Matrix3d C;
  for (int k = 0; k < 3; ++k) C.col(k) = M.col((k + 1) % 3).cross(M.col((k + 2) % 3));
  return C;
}

Svd3 svd3(const Eigen::Matrix3d& M) {
  Svd3 svd{M, Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero()};
  constexpr int kMaxSweeps = 20;  // four are usual
  for (int sweep = 0; sweep < kMaxSweeps; ++sweep) {
    bool turned = orthogonalise(svd, 0, 1);
    turned |= orthogonalise(svd, 0, 2);
    turned |= orthogonalise(svd, 1, 2);
    if (!turned) break;
  }
  svd.lengths = svd.W.colwise().norm().transpose();
  sort_columns(svd);
  return svd;
}

Eigen::Matrix3d rank_two(const Eigen::Matrix3d& M) {
  Eigen::Vector3d v;
  if (!smallest_direction(M, &v)) v = svd3(M).V.col(2);
  return scaled(M - M * v * v.transpose());
}

Eigen::Matrix3d nearest_essential(const Eigen::Matrix3d& M) {
  const Svd3 svd = svd3(M);
  return svd.W.col(0) / svd.lengths[0] * svd.V.col(0).transpose() +
         svd.W.col(1) / svd.lengths[1] * svd.V.col(1).transpose();
}

}  // namespace epi360
