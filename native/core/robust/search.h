// SPDX-License-Identifier: BSD-3-Clause
// The search for poses: samples, their gates, and the candidates that all matches refine.
#pragma once

#include "core/matches.h"
#include "core/robust/candidates.h"
#include "core/robust/options.h"
#include "core/robust/random.h"

namespace epi360 {

// The gate where nothing was found that tells it, radians.
double default_gate();

// The gate of a pose with this mixture, radians.
double estimated_gate(const LossModel& mixture);

struct SearchResult {
  Candidates candidates;  // of all matches
  int num_iterations;     // samples drawn
};

SearchResult search_poses(const Matches& m, const RobustOptions& options, const MatchPriors& priors,
                          Random& random);

}  // namespace epi360
