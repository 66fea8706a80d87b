// SPDX-License-Identifier: BSD-3-Clause
#include "core/solvers/dense.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <Eigen/QR>

namespace epi360 {

Eigen::Vector3d solve_symmetric(const Eigen::Matrix3d& M, const Eigen::Vector3d& right) {
  return M.ldlt().solve(right);
}

Vector5 solve_symmetric(const Matrix5& M, const Vector5& right) { return M.ldlt().solve(right); }

Vector6 solve_symmetric(const Matrix6& M, const Vector6& right) { return M.ldlt().solve(right); }

Matrix5 solve_symmetric(const Matrix5& M, const Matrix5& right) { return M.ldlt().solve(right); }

Matrix5 inverse(const Matrix5& M) { return M.inverse(); }

SmallMatrix symmetric_eigenvectors(const SmallMatrix& M) {
  return Eigen::SelfAdjointEigenSolver<SmallMatrix>(M).eigenvectors();
}

Eigen::Matrix<double, 9, 1> orthogonal_to(const Eigen::Matrix<double, 9, 8>& columns) {
  const Eigen::HouseholderQR<SmallMatrix> qr{SmallMatrix(columns)};
  Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 9, 1> last = Eigen::Matrix<double, 9, 1>::Unit(8);
  last.applyOnTheLeft(qr.householderQ());
  return last;
}

}  // namespace epi360
