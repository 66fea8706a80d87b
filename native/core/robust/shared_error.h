// SPDX-License-Identifier: BSD-3-Clause
// The error that neighbouring matches share: stitching, calibration, rolling shutter. It does not
// average out over the matches, and much of it a wrong pose explains as well as the right one.
#pragma once

#include <vector>

#include "core/matches.h"
#include "core/pose.h"
#include "core/refinement/refine.h"
#include "core/solvers/dense.h"

namespace epi360 {

struct SharedError {
  double variance = 0.0;                 // tau^2 below, radians^2
  Matrix5 covariance = Matrix5::Zero();  // radians^2, of the five parameters of the pose
};

// What the pose may be off by a shared error.
//
// Model: each view has a random field of displacements over its sphere, of standard deviation tau
// and with a correlation that falls off exponentially with the angle. Then the covariance of two
// residuals is tau^2 K_ij with K_ij = k(b1_i, b1_j) u1_i . u1_j + k(b2_i, b2_j) u2_i . u2_j, where
// u are the gradients of the residual by the two bearings, scaled to |u1|^2 + |u2|^2 = 1. tau^2 is
// estimated by the method of moments from r^T K r of the residuals left by the fit, the matches of
// one cell together, and counts if it is significant; at least (least * scale)^2 is assumed, as the
// longest waves of the field are those that the fit takes for motion and hides. Matches in few
// cells show nothing of the field: then the least is all.
//
// at: residuals and Jacobians at the pose, weights zero for matches that do not count.
SharedError shared_error(const Matches& m, const RelativePose& cam2_from_cam1,
                         const Linearisation& at, double scale, double least);

// Share of the inliers that would tell as much of the size of the angles between R b1 and b2 if
// their errors were independent: (tr C)^2 / (2 |C|^2) matches, with the covariance C of two
// components each, without what the rotation that fits best takes up. NaN where they lie in one
// direction and fix none. `shared`: tau^2 over the variance of one component of a match.
double independent_share(const Matches& m, const std::vector<unsigned char>& inlier, double shared);

}  // namespace epi360
