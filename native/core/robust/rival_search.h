// SPDX-License-Identifier: BSD-3-Clause
// The search for another pose among the matches that an accepted one leaves.
#pragma once

#include <vector>

#include "core/matches.h"
#include "core/pose.h"
#include "core/robust/options.h"
#include "core/robust/random.h"

namespace epi360 {

struct RivalSearchResult {
  std::vector<RelativePose> poses;  // refined on what is left, the likeliest first
  int num_iterations = 0;           // samples drawn
};

// A search that stops at the first good pose may never see a second one that explains as many
// matches. Of the matches that the first one leaves, the second explains a larger share than of
// all, so that a few samples find it; where too few are left for it, nothing is drawn.
// inlier, gate (radians): those of the first pose.
RivalSearchResult search_rivals(const Matches& m, const RobustOptions& options,
                                const MatchPriors& priors, const std::vector<unsigned char>& inlier,
                                double gate, int max_iterations, Random& random);

}  // namespace epi360
