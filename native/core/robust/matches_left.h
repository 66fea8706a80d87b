// SPDX-License-Identifier: BSD-3-Clause
// Some matches of a pair left out, to ask what the others say.
#pragma once

#include <cstddef>
#include <vector>

#include "core/matches.h"
#include "core/residuals/residuals.h"
#include "core/robust/estimate.h"
#include "core/robust/options.h"

namespace epi360 {

// One for each match: whether it is among the chosen.
std::vector<unsigned char> mask_of(const Matches& m, const std::vector<std::size_t>& chosen);

// Some matches of a pair, their rows in it, and what is known of them.
struct MatchesLeft {
  std::vector<std::size_t> rows;
  Matches m;
  MatchPriors priors;
};
MatchesLeft only(const Matches& m, const MatchPriors& priors, std::vector<std::size_t> rows);

// The other ones.
MatchesLeft without(const Matches& m, const MatchPriors& priors,
                    const std::vector<std::size_t>& some);

// Residuals of matches under the pose of an answer, or under its rotation alone.
std::vector<double> residuals_under(const RobustResult& answer, const Matches& m,
                                    Residual residual);

// The answer of the others with the inliers and residuals of all matches; none of those left out is
// an inlier.
RobustResult on_all(const Matches& m, const MatchesLeft& left, RobustResult answer,
                    Residual residual);

}  // namespace epi360
