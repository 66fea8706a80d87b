// SPDX-License-Identifier: BSD-3-Clause
// A pose whose inliers crowd on a few things, and what one match of each region says without them.
//
// Corner detectors find most of their points on what has most texture: a tram, a poster, a hedge.
// If that moves, or is taken for another one, a pose that explains it and some of the rest has most
// of the matches, and hardly any of the regions.
#pragma once

#include "core/robust/estimate.h"
#include "core/robust/verdict.h"

namespace epi360 {

// Whether the inliers are a far larger share of the matches than of the regions.
bool inliers_crowd(const Evidence& evidence);

// Whether the answer of one match of each region is the pose of all matches.
bool regions_confirm(const RobustResult& regions, const RobustResult& all);

}  // namespace epi360
