// SPDX-License-Identifier: BSD-3-Clause
#include "core/solvers/eight_point.h"

#include <cmath>

#include "core/bearings.h"
#include "core/solvers/dense.h"
#include "core/solvers/svd3.h"

namespace epi360 {
namespace {

using Flat = Eigen::Matrix<double, 9, 1>;

Eigen::Matrix3d from_flat(const Flat& flat) {
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(flat.data());
}

Flat smallest_vector(const Gram& M) {
  Flat flat;
  if (!smallest_eigenvector(M.data(), flat.data())) {
    flat = symmetric_eigenvectors(M).col(0);
  }
  return flat;
}

}  // namespace

Gram gram_matrix(const GramSums& sums) {
  Gram gram;
  for (int r = 0; r < 9; ++r) {
    for (int c = 0; c < 9; ++c) gram(r, c) = gram_entry(sums, r, c);
  }
  return gram;
}

Eigen::Matrix3d smallest_as_matrix(const Gram& M) { return from_flat(smallest_vector(M)); }

Eigen::Matrix3d smallest_as_matrix(const Gram& M, const Flat& d) {
  Flat flat = smallest_vector(d.asDiagonal() * M * d.asDiagonal());
  // An eigenvector is exact to (largest / smallest entry of D)^2 roundings.
  constexpr double kGraded = 4.0;
  if (d.maxCoeff() > kGraded * d.minCoeff()) {
    polish_scaled_eigenvector(M.data(), d.data(), flat.data());
  }
  return from_flat(flat);
}

Eigen::Matrix3d null_as_matrix(const Matches& m, const Eigen::Matrix3d& N1,
                               const Eigen::Matrix3d& N2) {
  Eigen::Matrix<double, 9, 8> rows;
  for (int i = 0; i < 8; ++i) {
    const Eigen::Vector3d b1 = N1 * view1(m, i);
    const Eigen::Vector3d b2 = N2 * view2(m, i);
    for (int r = 0; r < 3; ++r) rows.block<3, 1>(3 * r, i) = std::sqrt(m.weight[i]) * b2[r] * b1;
  }
  return from_flat(orthogonal_to(rows));
}

Eigen::Matrix3d eight_point(const Matches& m) {
  return rank_two(smallest_as_matrix(gram_matrix(gram_sums(m))));
}

bool eight_point_minimal(const Eigen::Matrix<double, 3, 8>& bearings1,
                         const Eigen::Matrix<double, 3, 8>& bearings2, Eigen::Matrix3d* E) {
  Eigen::Matrix<double, 9, 8> rows;
  for (int i = 0; i < 8; ++i) {
    for (int r = 0; r < 3; ++r) rows.block<3, 1>(3 * r, i) = bearings2(r, i) * bearings1.col(i);
  }
  const Flat flat = orthogonal_to(rows);
  if (!flat.allFinite()) return false;
  *E = rank_two(from_flat(flat));
  return true;
}

}  // namespace epi360
