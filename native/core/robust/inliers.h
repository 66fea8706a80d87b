// SPDX-License-Identifier: BSD-3-Clause
// Which matches agree with a pose: residuals, gates and depths.
#pragma once

#include <vector>

#include "core/matches.h"
#include "core/residuals/residuals.h"
#include "core/robust/candidates.h"

namespace epi360 {

// Among the four poses of this E, the one with most inliers in front of both cameras.
void decide_cheirality(const Matches& m, const std::vector<unsigned char>& inlier,
                       RelativePose& cam2_from_cam1);

// Flags matches inside the gate and in front of both cameras; returns their weight. `behind` gets
// that of the matches inside the gate that lie behind a camera by more than noise explains.
double mark_inliers(const Matches& m, Residual residual, const RelativePose& cam2_from_cam1,
                    double gate, bool use_depths, std::vector<unsigned char>& inlier,
                    std::vector<double>& residuals, double* behind = nullptr);

// Weight of the matches behind the cameras with which these have only turned, if one of the images
// is mirrored: with the mirror across the translation of this pose, which then is none. In front,
// points on the plane halfway between the cameras are where that mirror puts them, too. That a
// match stands still under the rotation tells nothing.
double weight_of_mirrored_turn(const Matches& m, const RelativePose& cam2_from_cam1, double gate);

// In a narrow view with much noise, a turn along the epipolar planes hardly changes the residuals,
// and large false parallax puts every wrong match in front of both cameras: the count of depths
// then pulls poses away from the residuals' own optimum, and prefers wrong ones. Where such an
// optimum has much less parallax and nearly the support of the best candidate, it takes its place.
void release_depths(const Matches& m, Residual residual, Candidates& candidates);

}  // namespace epi360
