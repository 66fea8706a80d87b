// SPDX-License-Identifier: BSD-3-Clause
// Relative pose with known gravity from three matches (Fraundorfer, Tanskanen & Pollefeys, "A
// minimal case solution to the calibrated relative pose problem for the case of two known
// orientation angles", ECCV 2010).
#pragma once

#include <Eigen/Core>

#include "core/pose.h"

namespace epi360 {

// Rotation that takes a direction to +y, the direction of gravity in an upright camera.
Eigen::Matrix3d upright_from(const Eigen::Vector3d& gravity);

// bearings of both views as columns; upright1 and upright2 as upright_from gives them. Writes up to
// four poses, t up to sign, and returns their number.
int upright_three_point(const Eigen::Matrix3d& bearings1, const Eigen::Matrix3d& bearings2,
                        const Eigen::Matrix3d& upright1, const Eigen::Matrix3d& upright2,
                        RelativePose* poses);

}  // namespace epi360
