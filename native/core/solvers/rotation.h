// SPDX-License-Identifier: BSD-3-Clause
// Pure rotation between two views: b2 = R b1.
#pragma once

#include "core/matches.h"
#include "core/pose.h"

namespace epi360 {

// Rotation of least squares sum w |R b1 - b2|^2 (Horn 1987; the eigenvector form).
Eigen::Matrix3d align_rotations(const Matches& m, const double* weights);

// Rotation that takes two bearings to two others, exact when their angles agree.
bool rotation_of_two(const Eigen::Vector3d& a1, const Eigen::Vector3d& b1,
                     const Eigen::Vector3d& a2, const Eigen::Vector3d& b2, Eigen::Matrix3d* R);

}  // namespace epi360
