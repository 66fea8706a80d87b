// SPDX-License-Identifier: BSD-3-Clause
// Singular values of a 3x3 matrix by one-sided Jacobi rotations (Golub & Van Loan, "Matrix
// Computations", section 8.6.3), which keeps the digits of the small ones.
#pragma once

#include <Eigen/Core>
#include <cmath>

namespace epi360 {

// M V = W with orthogonal columns; column k of W has the length of singular value k, descending.
struct Svd3 {
  Eigen::Matrix3d W, V;
  Eigen::Vector3d lengths;
};

Eigen::Matrix3d cofactors(const Eigen::Matrix3d& M);

Svd3 svd3(const Eigen::Matrix3d& M);

// M without its smallest singular value, scaled to ||M||_F = sqrt 2.
Eigen::Matrix3d rank_two(const Eigen::Matrix3d& M);

// Of Frobenius norm sqrt 2.
inline Eigen::Matrix3d scaled(const Eigen::Matrix3d& E) { return E * (std::sqrt(2.0) / E.norm()); }

// Nearest matrix with singular values (1, 1, 0), to working precision if the first two are not
// zero; NaN else.
Eigen::Matrix3d nearest_essential(const Eigen::Matrix3d& M);

}  // namespace epi360
