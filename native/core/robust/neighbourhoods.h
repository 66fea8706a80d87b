// SPDX-License-Identifier: BSD-3-Clause
// Which matches lie near one another: groups that exchange partners, and regions with one vote.
#pragma once

#include <cstddef>
#include <vector>

#include "core/matches.h"

namespace epi360 {

// Pairs of matches that share a neighbourhood in view 1 or 2. That is a few matches or, where more
// lie within `reach` (radians), all of these, of which each exchanges partners with a few from all
// over.
struct Exchange {
  std::vector<std::size_t> own, other;
};
Exchange exchanged_partners(const Matches& m, int view, double reach);

// What each match says: matches that lie near one another in both views share one vote, or less if
// together they weigh less than one match.
std::vector<double> region_weights(const Matches& m);

// One match of each region, the heaviest and of these the first one: all others lie near one of
// these in both views, and none of these near another one. In ascending order.
std::vector<std::size_t> one_of_each_region(const Matches& m);

}  // namespace epi360
