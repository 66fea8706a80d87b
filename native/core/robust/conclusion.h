// SPDX-License-Identifier: BSD-3-Clause
// The end of an estimate: where its inliers lie, the verdict on everything, and NaN in the place of
// what that leaves undetermined.
#pragma once

#include "core/matches.h"
#include "core/robust/estimate.h"
#include "core/robust/options.h"

namespace epi360 {

// max_noise: as of `MatchPriors`.
void conclude(const Matches& m, const RobustOptions& options, const RowCounts& rows,
              double max_noise, RobustResult& r);

}  // namespace epi360
