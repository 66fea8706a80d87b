// SPDX-License-Identifier: BSD-3-Clause
// Small dense linear algebra. Each decomposition of Eigen costs seconds to compile, so each is
// compiled once, here.
#pragma once

#include <Eigen/Core>

namespace epi360 {

using Vector5 = Eigen::Matrix<double, 5, 1>;
using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix5 = Eigen::Matrix<double, 5, 5>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;
using SmallMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, 9, 9>;

// x of M x = right, M symmetric (LDL^T with pivots).
Eigen::Vector3d solve_symmetric(const Eigen::Matrix3d& M, const Eigen::Vector3d& right);
Vector5 solve_symmetric(const Matrix5& M, const Vector5& right);
Vector6 solve_symmetric(const Matrix6& M, const Vector6& right);
Matrix5 solve_symmetric(const Matrix5& M, const Matrix5& right);

Matrix5 inverse(const Matrix5& M);

// Eigenvectors of a symmetric matrix by ascending eigenvalue.
SmallMatrix symmetric_eigenvectors(const SmallMatrix& M);

// Unit vector orthogonal to eight columns.
Eigen::Matrix<double, 9, 1> orthogonal_to(const Eigen::Matrix<double, 9, 8>& columns);

}  // namespace epi360
