// SPDX-License-Identifier: BSD-3-Clause
// Matches that would fix the pose alone.
#pragma once

#include <vector>

#include "core/matches.h"
#include "core/residuals/residuals.h"
#include "core/robust/candidates.h"

namespace epi360 {

// A wrong match that agrees by chance may hold a thousand times the information of the right ones:
// one with 100 degrees of parallax among far points. No such match may fix the pose alone: those
// whose leverage and parallax are beyond the limits are left out, and the best candidate is refined
// again. Flags them. (With few inliers, right ones have such leverage too.)
std::vector<unsigned char> drop_leverage(const Matches& m, Residual residual,
                                         Candidates& candidates);

}  // namespace epi360
