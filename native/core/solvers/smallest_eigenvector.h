// SPDX-License-Identifier: BSD-3-Clause
// Eigenvector of the smallest eigenvalue of a symmetric positive semidefinite 9x9 matrix, at a
// quarter of the cost of all nine. Plain loops, no Eigen.
#pragma once

namespace epi360 {

// M: row-major, both triangles. v: unit length. False where working precision was not reached
// (entries that are not finite, a matrix that falls apart into blocks): take a full solver then.
bool smallest_eigenvector(const double* M, double* v);

// One step of Rayleigh quotient iteration for the eigenvector v of D M D, D = diag(d), on M itself:
// what the grading of D M D took from v's accuracy comes back. v: near the eigenvector, of unit
// length; so is the result. Unchanged where the step has no finite result.
void polish_scaled_eigenvector(const double* M, const double* d, double* v);

}  // namespace epi360
