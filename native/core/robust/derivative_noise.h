// SPDX-License-Identifier: BSD-3-Clause
// What the noise of the bearings does to the derivatives that a covariance is made of: noisy copies
// of one point seem to lie in different directions, and matches without parallax seem to have some.
#pragma once

#include "core/matches.h"
#include "core/pose.h"
#include "core/refinement/refine.h"
#include "core/residuals/residuals.h"
#include "core/solvers/dense.h"

namespace epi360 {

struct NoisyInformation {
  Matrix5 total;     // J^T W J / variance, with what noise adds to it
  Matrix5 noise;     // that
  double deviation;  // of the noise, as a share of it: squares of Gaussian numbers scatter
};

// With the derivatives D of J by what is noisy in both views (pixels, or bearings along two axes)
// the noise adds the sum of w D D^T, for it has the variance that J^T W J is divided by. A match of
// which it makes up much, as near an epipole, counts less.
//
// at: Jacobians at the pose, and the matches' weights; variance: of their residuals.
NoisyInformation noisy_information(const Matches& m, Residual residual,
                                   const RelativePose& cam2_from_cam1, const Linearisation& at,
                                   double variance);

// Covariance A^-1 + A^-1 N A^-1 of what J^T W J / variance = A + N determines, where N is the noise
// of the derivatives: errors in variables (Fuller 1987, section 2.2). The second term counts where
// the parallax is not large against the noise. In A^-1 the noise is taken to have added one
// standard deviation more than usual.
Matrix5 errors_in_variables(const NoisyInformation& information);

// Inverse of an information matrix; a direction that it does not determine gets the standard
// deviation of knowing nothing, never an infinite or a negative variance.
Matrix5 bounded_inverse(const Matrix5& information);

// Standard deviations of the bearings' noise, per axis and view, that one of the residuals stands
// for: the one-sided ones see the noise of both views at once.
double noise_per_residual(Residual residual);

}  // namespace epi360
