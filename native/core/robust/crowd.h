// SPDX-License-Identifier: BSD-3-Clause
// A pose whose inliers crowd on a few things, and what one match of each region says without them.
//
// Corner detectors find most of their points on what has most texture: a tram, a poster, a hedge.
// If that moves, or is taken for another one, a pose that explains it and some of the rest has most
// of the matches, and hardly any of the regions.
#pragma once

#include <cstdint>

#include "core/matches.h"
#include "core/robust/estimate.h"
#include "core/robust/matches_left.h"
#include "core/robust/options.h"
#include "core/robust/verdict.h"

namespace epi360 {

// Whether the inliers are a far larger share of the matches than of the regions.
bool inliers_crowd(const Evidence& evidence);

// One match of each region, of some thousand matches at the most.
MatchesLeft one_for_each_region(const Matches& m, const MatchPriors& priors, std::uint64_t seed);

// How long these are searched: wrong matches, each of which is a region, are most of them.
RobustOptions options_of_regions(const RobustOptions& options);

// Whether the answer of one match of each region, `few`, is a turn, or another pose than that of
// all matches which explains more of them, and not by chance. If they say nothing, that says
// nothing of the pose.
bool regions_contradict(const Matches& few, Residual residual, const RobustResult& regions,
                        const RobustResult& all);

}  // namespace epi360
