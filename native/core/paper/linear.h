// SPDX-License-Identifier: BSD-3-Clause
// The eight-point algorithm in normalised domains and with Taubin's constraint (paper sections 3
// and 4.1). The twins are epipolar/normalization.py and epipolar/linear.py.
#pragma once

#include <Eigen/Core>

#include "core/matches.h"

namespace epi360 {

// kGiven: N = diag(S, S, K).
enum class Normalization { kNone, kIsotropic, kNonIsotropic, kIsotropicNonIsotropic, kGiven };
enum class Constraint { kUnit, kTaubin };

struct LinearSolution {
  Eigen::Matrix3d E;  // rank 2, ||E||_F = sqrt 2
  Eigen::Matrix3d N1 = Eigen::Matrix3d::Identity(), N2 = Eigen::Matrix3d::Identity();
};

// At least eight matches, all of positive weight. Throws std::domain_error where the bearings do
// not allow the normalisation or the constraint.
LinearSolution solve_linear(const Matches& m, Normalization normalization, Constraint constraint,
                            double S = 1.0, double K = 1.0);

}  // namespace epi360
