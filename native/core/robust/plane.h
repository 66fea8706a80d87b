// SPDX-License-Identifier: BSD-3-Clause
// Scenes that lie on one plane: two poses explain their matches equally well.
#pragma once

#include <vector>

#include "core/matches.h"
#include "core/pose.h"

namespace epi360 {

// The plane n . X = 1 (X in camera 1, |t| = 1) that fits the chosen matches best under a pose, with
// residuals of up to `gate` radians; `share` gets the share of the chosen within the gate.
Eigen::Vector3d fit_plane(const Matches& m, const RelativePose& pose,
                          const std::vector<unsigned char>& chosen, double gate, double* share);

// The other pose with the same homography R + t n^T (Ma, Soatto, Kosecka & Sastry, "An Invitation
// to 3-D Vision", 2004, section 5.3). False if there is none.
bool twin_pose(const RelativePose& pose, const Eigen::Vector3d& n, RelativePose* twin);

}  // namespace epi360
