// SPDX-License-Identifier: BSD-3-Clause
#include "core/solvers/dense.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Householder>
#include <Eigen/LU>

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

// The last column of Q of a Householder QR. Written out: Eigen's class takes blocks of columns at a
// time, whose matrix products compile for five seconds.
Eigen::Matrix<double, 9, 1> orthogonal_to(const Eigen::Matrix<double, 9, 8>& columns) {
  Eigen::Matrix<double, 9, 8> A = columns;
  double tau[8], length, workspace[8];
  for (int k = 0; k < 8; ++k) {
    A.col(k).tail(9 - k).makeHouseholderInPlace(tau[k], length);
    A(k, k) = length;
    A.bottomRightCorner(9 - k, 7 - k)
        .applyHouseholderOnTheLeft(A.col(k).tail(8 - k), tau[k], workspace);
  }
  Eigen::Matrix<double, 9, 1> last = Eigen::Matrix<double, 9, 1>::Unit(8);
  for (int k = 7; k >= 0; --k) {
    last.tail(9 - k).applyHouseholderOnTheLeft(A.col(k).tail(8 - k), tau[k], workspace);
  }
  return last;
}

}  // namespace epi360
