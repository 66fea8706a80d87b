// SPDX-License-Identifier: BSD-3-Clause
// Key points on a grid of pixels or cells, as of FAST, ORB and coarse matchers of patches. Where the
// camera hardly moves many of them agree exactly on a pose, which may be a wrong one, and with a
// rotation where it moved: their noise is not what residuals say.
#pragma once

#include "core/matches.h"

namespace epi360 {

// Standard deviation (radians) of bearings on a grid, that of rounding to its cells; 0 unless the
// bearings of both views are on one: of a panorama by their latitudes, of a pinhole camera by their
// slopes.
double grid_noise(const Matches& m);

}  // namespace epi360
