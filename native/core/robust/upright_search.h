// SPDX-License-Identifier: BSD-3-Clause
// Every pose of two cameras that stand upright and at one height: two angles, so all are tried.
#pragma once

#include <vector>

#include "core/matches.h"
#include "core/pose.h"
#include "core/refinement/pose_prior.h"

namespace epi360 {

// The best poses on a grid of heading and direction (2 and 4 degrees), each at least 8 degrees of
// heading from a better one, the best first. Finds poses whose few right matches no random sample
// of three is likely to hold.
std::vector<RelativePose> upright_poses(const Matches& m, const PosePrior& prior, int most);

}  // namespace epi360
