// SPDX-License-Identifier: BSD-3-Clause
// What lies on one side of the camera and says another motion than all that lies elsewhere.
//
// A car that drives by moves far more than the scene, and the direction of a translation is known
// best from what moves most: a hundred matches on the car outvote three hundred around it, most of
// which agree with the car's direction to the noise all the same. So the others are asked alone.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/matches.h"
#include "core/robust/estimate.h"
#include "core/robust/matches_left.h"

namespace epi360 {

// Sides of different widths without which the direction of a pose is known much less: on each the
// inliers that moved more than those elsewhere, if these are all around the camera.
std::vector<std::vector<std::size_t>> sides_that_say_most(const Matches& m, Residual residual,
                                                          const RelativePose& pose,
                                                          const std::vector<unsigned char>& inlier);

// Inliers that the others are asked without: those on one side, or all of them.
struct Side {
  std::vector<std::size_t> rows;
  bool is_all = false;
};

// The sides without which a pose is asked for again: one that alone says where the camera moved, if
// a short search among all other matches finds another direction; and all inliers, if they cover
// little of what the matches cover.
std::vector<Side> sides_to_ask(const Matches& m, const RobustOptions& options,
                               const MatchPriors& priors, std::uint64_t seed,
                               const RobustResult& answer);

// The options for the matches beside a side: beside all inliers a shorter search.
RobustOptions options_beside(const Side& side, const RobustOptions& options);

// Whether the answer of the others, `left`, speaks against that of all matches: a pose around the
// camera with another direction; or a turn, of which not even the sign of the parallax of the
// others agrees with that pose, and beside which the side moved more than anything that stands
// still may.
bool contradicts(const Matches& m, const Side& side, const MatchesLeft& left,
                 const RobustResult& others, const RobustResult& all);

}  // namespace epi360
