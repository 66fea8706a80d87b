// SPDX-License-Identifier: BSD-3-Clause
// Longuet-Higgins, "A computer algorithm for reconstructing a scene from two projections",
// Nature 1981, on bearing vectors.
#pragma once

#include <Eigen/Core>

#include "core/matches.h"
#include "core/solvers/gram.h"

namespace epi360 {

using Gram = Eigen::Matrix<double, 9, 9>;

// A^T A of these sums.
Gram gram_matrix(const GramSums& sums);

// Unit vector e of least e^T M e as a matrix, row by row.
Eigen::Matrix3d smallest_as_matrix(const Gram& M);

// The same of D M D, D = diag(d).
Eigen::Matrix3d smallest_as_matrix(const Gram& M, const Eigen::Matrix<double, 9, 1>& d);

// Unit vector of A e = 0 for the first eight matches, bearings multiplied by N1 and N2, rows by
// the roots of the weights: keeps the digits that A^T A would lose.
Eigen::Matrix3d null_as_matrix(const Matches& m, const Eigen::Matrix3d& N1,
                               const Eigen::Matrix3d& N2);

// Least-squares E over all matches, rank 2 by zeroing the smallest singular value,
// ||E||_F = sqrt 2.
Eigen::Matrix3d eight_point(const Matches& m);

// E of exactly eight matches by the null space of A.
bool eight_point_minimal(const Eigen::Matrix<double, 3, 8>& bearings1,
                         const Eigen::Matrix<double, 3, 8>& bearings2, Eigen::Matrix3d* E);

}  // namespace epi360
