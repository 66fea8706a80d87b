// SPDX-License-Identifier: BSD-3-Clause
// The end of an estimate: where its inliers lie, the verdict on everything, and NaN in the place of
// what that leaves undetermined.
#pragma once

#include <cstddef>

#include "core/matches.h"
#include "core/robust/estimate.h"
#include "core/robust/options.h"

namespace epi360 {

// num_matches: as of `estimate_relative_pose`. max_noise: as of `MatchPriors`.
void conclude(const Matches& m, const RobustOptions& options, std::size_t num_matches,
              double max_noise, RobustResult& r);

}  // namespace epi360
