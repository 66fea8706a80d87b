// SPDX-License-Identifier: BSD-3-Clause
// What is known of a pose before any match: where down is in both cameras, and that they stand at
// one height.
#pragma once

#include <Eigen/Core>

#include "core/pose.h"

namespace epi360 {

struct PosePrior {
  bool has_gravity = false;
  Eigen::Vector3d gravity1 = Eigen::Vector3d::UnitY(), gravity2 = Eigen::Vector3d::UnitY();
  double gravity_sigma = 0.0;    // radians, per axis and view
  double elevation_sigma = 0.0;  // radians, of the translation over the horizon; 0: any

  // Negative log-likelihood of a pose, up to a constant.
  double cost(const RelativePose& pose) const;
  // Adds its second derivatives and gradient by (w, d) as in residuals.h: R' = exp([w]x) R,
  // t' = (t + basis d) / |.|.
  void accumulate(const RelativePose& pose, const Eigen::Matrix<double, 3, 2>& basis, double factor,
                  Eigen::Matrix<double, 5, 5>& hessian,
                  Eigen::Matrix<double, 5, 1>& gradient) const;
};

}  // namespace epi360
