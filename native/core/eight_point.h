// SPDX-License-Identifier: BSD-3-Clause
// Longuet-Higgins, "A computer algorithm for reconstructing a scene from two projections",
// Nature 1981, on bearing vectors.
#pragma once

#include <Eigen/Core>

#include "matches.h"

namespace epi360 {

// Weighted Gram matrix A^T A of the observation matrix with rows b2 (x) b1.
Eigen::Matrix<double, 9, 9> gram_matrix(const Matches& m);

// Least-squares E over all matches (N > 8), rank 2 by zeroing the smallest singular value,
// ||E||_F = sqrt 2.
Eigen::Matrix3d eight_point(const Matches& m);

// E of exactly eight matches by the null space of A: keeps the digits that A^T A would lose.
bool eight_point_minimal(const Eigen::Matrix<double, 3, 8>& bearings1,
                         const Eigen::Matrix<double, 3, 8>& bearings2, Eigen::Matrix3d* E);

}  // namespace epi360
