// SPDX-License-Identifier: BSD-3-Clause
// Nistér, "An efficient solution to the five-point relative pose problem", PAMI 2004.
#pragma once

#include <Eigen/Core>

namespace epi360 {

// bearings1, bearings2: five matches as columns, any non-zero length and any direction of the
// sphere. Writes up to ten essential matrices (b2^T E b1 = 0, ||E||_F = sqrt 2) and returns their
// number.
int five_point(const Eigen::Matrix<double, 3, 5>& bearings1,
               const Eigen::Matrix<double, 3, 5>& bearings2, Eigen::Matrix3d* essentials);

}  // namespace epi360
