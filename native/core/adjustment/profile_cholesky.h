// SPDX-License-Identifier: BSD-3-Clause
// Cholesky factorisation of a symmetric matrix whose rows start with zeros: frames that are far
// apart in a video share no points.
#pragma once

#include <cstddef>

namespace epi360 {

// The lower triangle by rows: columns first[i] to i of row i stand from rows + start[i] on. It is
// replaced by its factor, and right by the solution. False if the matrix is not positive.
bool solve_profile(double* rows, const std::size_t* start, const std::size_t* first, std::size_t n,
                   double* right);

}  // namespace epi360
