// SPDX-License-Identifier: BSD-3-Clause
// Nistér, "An efficient solution to the five-point relative pose problem", PAMI 2004.
#pragma once

namespace epi360 {

// bearings1, bearings2: five matches, (5, 3) row-major, any non-zero length and any direction of
// the sphere. Writes up to ten essential matrices, row-major (b2^T E b1 = 0, ||E||_F = sqrt 2), and
// returns their number.
int five_point(const double* bearings1, const double* bearings2, double* essentials);

}  // namespace epi360
