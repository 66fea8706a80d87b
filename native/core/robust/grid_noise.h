// SPDX-License-Identifier: BSD-3-Clause
// Key points on a grid of pixels or cells, as of FAST, ORB and coarse matchers of patches. Where
// the camera hardly moves many of them agree exactly on a pose, which may be a wrong one, and with
// a rotation where it moved: their noise is not what residuals say.
#pragma once

#include "core/matches.h"
#include "core/residuals/residuals.h"
#include "core/robust/estimate.h"

namespace epi360 {

// Standard deviation (radians) of bearings on a grid, that of rounding to its cells; 0 unless
// points of both views share rows and columns: of a panorama latitudes and longitudes, of a pinhole
// camera slopes.
double grid_noise(const Matches& m);

// The scale of residuals that an answer should have been found with at least, because the bearings
// are on a grid and many of those that are no inliers are nearer than rounding explains; 0 where it
// is as good as it says. Points of an exact scene may share rows too, but none is nearly right.
double least_scale_of_grid(const Matches& m, Residual residual, const RobustResult& answer);

}  // namespace epi360
