// SPDX-License-Identifier: BSD-3-Clause
// Sums over matches that the linear estimators need: plain loops, no Eigen (see multiversion.h).
#pragma once

#include "core/matches.h"

namespace epi360 {

// The 36 distinct entries of A^T A, row i of A being sqrt(w) b2 (x) b1: sums[6 * k + l] adds
// w * (product k of b2) * (product l of b1), products in the order xx, xy, xz, yy, yz, zz.
struct GramSums {
  double sums[36];
};

GramSums gram_sums(const Matches& m);

// The same of N1 b1 and N2 b2; matrices row-major.
GramSums gram_sums(const Matches& m, const double* N1, const double* N2);

// Weighted moments of the bearings of one view.
struct ViewMoments {
  double weight, mean[3], second[6];  // second: sums, not means, in the order of the products
  double variance;                    // mean squared distance from the mean
};

ViewMoments view_moments(const Matches& m, int view);

// Entry (r, c) of the symmetric 9x9 matrix: the product b_i b_j of one view has number
// kProduct[i][j].
constexpr int kProduct[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};

inline double gram_entry(const GramSums& g, int r, int c) {
  return g.sums[6 * kProduct[r / 3][c / 3] + kProduct[r % 3][c % 3]];
}

// Eigenvector of the smallest eigenvalue of a symmetric positive semidefinite 9x9 matrix, at a
// quarter of the cost of all nine.
// M: row-major, both triangles. v: unit length. False where working precision was not reached
// (entries that are not finite, a matrix that falls apart into blocks): take a full solver then.
bool smallest_eigenvector(const double* M, double* v);

// One step of Rayleigh quotient iteration for the eigenvector v of D M D, D = diag(d), on M itself:
// what the grading of D M D took from v's accuracy comes back. v: near the eigenvector, of unit
// length; so is the result. Unchanged where the step has no finite result.
void polish_scaled_eigenvector(const double* M, const double* d, double* v);

}  // namespace epi360
