// SPDX-License-Identifier: BSD-3-Clause
// Residuals of an essential matrix that need not have equal singular values, weights from the
// distribution that residuals show (paper section 4.3; step by step as estimation/weights.py) and
// the cheirality of the poses. Plain loops, no Eigen: see multiversion.h.
#pragma once

#include "core/matches.h"

namespace epi360 {

// Signed sines (eq. 13): b2^T E b1 / |E b1|. E: row-major, any scale.
void essential_residuals(const Matches& m, const double* E, double* residuals);

// Sum of the absolute residuals (eq. 14).
double absolute_residual_sum(const Matches& m, const double* E);

enum class Weighting { kNone, kGaussian, kStudentT };

// weights[i] for m.padded residuals; zero on the padding.
void residual_weights(const Matches& m, const double* residuals, Weighting kind, double* weights);

// Sum of weight * residual^2.
double weighted_squares(const Matches& m, const double* residuals, const double* weights);

// Matches with both depths positive under (R, t), (R, -t), (R', t) and (R', -t), R' being R turned
// by half a turn about t. R: row-major; t: of unit length.
struct FrontCounts {
  double matches[4];
};

FrontCounts count_in_front(const Matches& m, const double* R, const double* t);

}  // namespace epi360
