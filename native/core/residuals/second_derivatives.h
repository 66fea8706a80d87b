// SPDX-License-Identifier: BSD-3-Clause
// How the derivatives of residuals by the pose change with what is noisy in both views. A plain
// loop without Eigen, as in residuals.h.
#pragma once

#include "core/matches.h"
#include "core/residuals/residuals.h"

namespace epi360 {

// What moves the bearings of a match: two pixels in either view where the cameras' Jacobians are
// known, else either bearing along two axes of its tangent plane.
constexpr std::size_t kMoves = 4;

// Derivatives D of J, the row of compute_jacobians, by each move, of every match where its residual
// is zero: derivatives[(5 * move + k) * padded + i]. squared_jacobian[i] is |J|^2.
void compute_second_derivatives(const Matches& m, Residual kind, const PlainPose& pose,
                                const double* basis, double* derivatives, double* squared_jacobian);

}  // namespace epi360
