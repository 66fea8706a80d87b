// SPDX-License-Identifier: BSD-3-Clause
// Signed residuals of matches under a pose, their Jacobians and the truncated score. Plain loops
// over structure-of-arrays doubles, no Eigen: see multiversion.h.
#pragma once

#include <cstddef>

#include "core/matches.h"

namespace epi360 {

enum class Residual { kPaper, kAngular, kSampson, kTangentSampson };

// A pose as plain numbers: R row-major.
struct PlainPose {
  double R[9];
  double t[3];
};

// residuals[i] for every match, padding included. margins[i] is negative where a depth is: parallax
// of the wrong sign, in radians (see depth_margins).
void compute_residuals(const Matches& m, Residual kind, const PlainPose& pose, double* residuals,
                       double* margins);

// Also the derivatives by (w, d): R' = exp([w]x) R, t' = (t + B d) / |.|. basis: B, row-major
// (3, 2). jacobian[k * padded + i] is the derivative of residual i by parameter k.
void compute_jacobians(const Matches& m, Residual kind, const PlainPose& pose, const double* basis,
                       double* residuals, double* margins, double* jacobian);

// With one gate or four. Sum over matches of weight * mean over gates of min(residual^2 / gate^2,
// 1); a match behind either camera by more than a gate costs 1 there. Stops early with a value
// above `limit`.
double truncated_score(const Matches& m, Residual kind, const PlainPose& pose, const double* gates,
                       int num_gates, double limit);

// The same of min((angle / sqrt 2)^2 / gate^2, 1) for a rotation: the Sampson distance to
// b2 = R b1 when both views carry noise.
double truncated_rotation_score(const Matches& m, const double* R, const double* gates,
                                int num_gates, double limit);

// |R b1 - b2| as an angle over sqrt 2, for every match.
void compute_rotation_residuals(const Matches& m, const double* R, double* residuals);

// Sums over all matches of weights w: hessian (15 numbers, upper triangle by rows) = J^T W J,
// gradient (5) = J^T W r. jacobian as compute_jacobians writes it.
void accumulate_normal_equations(std::size_t padded, const double* jacobian,
                                 const double* residuals, const double* weights, double* hessian,
                                 double* gradient);

}  // namespace epi360
