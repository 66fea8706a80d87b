// SPDX-License-Identifier: BSD-3-Clause
#include "eight_point.h"

#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <Eigen/SVD>
#include <cmath>

namespace epi360 {
namespace {

using Flat = Eigen::Matrix<double, 9, 1>;

Eigen::Matrix3d from_flat(const Flat& flat) {
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(flat.data());
}

Eigen::Matrix3d rank_two(const Eigen::Matrix3d& E) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(E, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d s = svd.singularValues();
  s[2] = 0.0;
  s *= std::sqrt(2.0) / s.norm();
  return svd.matrixU() * s.asDiagonal() * svd.matrixV().transpose();
}

}  // namespace

Eigen::Matrix<double, 9, 9> gram_matrix(const Matches& m) {
  // A^T A = sum (b2 b2^T) (x) (b1 b1^T): 36 distinct sums instead of 81. Each product of a row of
  // six with a column of six is kept in one accumulator matrix.
  Eigen::Matrix<double, 6, 6> sums = Eigen::Matrix<double, 6, 6>::Zero();
  for (std::size_t i = 0; i < m.size; ++i) {
    const double x1 = m.x1[i], y1 = m.y1[i], z1 = m.z1[i];
    const double x2 = m.x2[i], y2 = m.y2[i], z2 = m.z2[i], w = m.weight[i];
    Eigen::Matrix<double, 6, 1> p1, p2;
    p1 << x1 * x1, x1 * y1, x1 * z1, y1 * y1, y1 * z1, z1 * z1;
    p2 << w * x2 * x2, w * x2 * y2, w * x2 * z2, w * y2 * y2, w * y2 * z2, w * z2 * z2;
    sums.noalias() += p1 * p2.transpose();
  }
  static constexpr int kPair[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};
  Eigen::Matrix<double, 9, 9> gram;
  for (int r = 0; r < 9; ++r) {
    for (int c = 0; c < 9; ++c) {
      gram(r, c) = sums(kPair[r % 3][c % 3], kPair[r / 3][c / 3]);
    }
  }
  return gram;
}

Eigen::Matrix3d eight_point(const Matches& m) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 9, 9>> solver(gram_matrix(m));
  return rank_two(from_flat(solver.eigenvectors().col(0)));
}

bool eight_point_minimal(const Eigen::Matrix<double, 3, 8>& bearings1,
                         const Eigen::Matrix<double, 3, 8>& bearings2, Eigen::Matrix3d* E) {
  Eigen::Matrix<double, 9, 8> rows;
  for (int i = 0; i < 8; ++i) {
    for (int r = 0; r < 3; ++r) rows.block<3, 1>(3 * r, i) = bearings2(r, i) * bearings1.col(i);
  }
  const Eigen::HouseholderQR<Eigen::Matrix<double, 9, 8>> qr(rows);
  Flat flat = Flat::Unit(8);
  flat.applyOnTheLeft(qr.householderQ());
  if (!flat.allFinite()) return false;
  *E = rank_two(from_flat(flat));
  return true;
}

}  // namespace epi360
