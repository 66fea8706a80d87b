// SPDX-License-Identifier: BSD-3-Clause
// Weights of residuals from the distribution that they show (paper section 4.3). Plain loops, no
// Eigen: see multiversion.h. Step by step as the twin in estimation/weights.py.
#pragma once

#include <cstddef>

#include "core/matches.h"

namespace epi360 {

enum class Weighting { kNone, kGaussian, kStudentT };

// weights[i] for m.padded residuals; zero on the padding.
void residual_weights(const Matches& m, const double* residuals, Weighting kind, double* weights);

// Sum of weight * residual^2.
double weighted_squares(const Matches& m, const double* residuals, const double* weights);

}  // namespace epi360
