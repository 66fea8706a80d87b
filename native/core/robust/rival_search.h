// SPDX-License-Identifier: BSD-3-Clause
// The search for another pose among the matches that an accepted one leaves.
#pragma once

#include <cstddef>
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
// inlier, gate (radians): those of the first pose. regions_left: those that it leaves over those
// that agree with it, see testimony.h; where there are far more than of the matches, its inliers
// crowd on a few things, and a second one may explain half as many.
RivalSearchResult search_rivals(const Matches& m, const RobustOptions& options,
                                const MatchPriors& priors, const std::vector<unsigned char>& inlier,
                                double gate, double regions_left, int max_iterations,
                                Random& random);

// The search itself, among some of the matches, of which a pose is taken to explain a share.
RivalSearchResult search_among(const Matches& m, std::vector<std::size_t> some, double share,
                               const RobustOptions& options, const MatchPriors& priors, double gate,
                               int max_iterations, Random& random);

}  // namespace epi360
