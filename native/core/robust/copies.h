// SPDX-License-Identifier: BSD-3-Clause
// Matches that repeat another one, to 12 digits of the bearings in both views: of joined lists, of
// key points with two directions, of a draw with replacement.
#pragma once

#include <cstddef>
#include <vector>

#include "core/matches.h"

namespace epi360 {

// For each match the first one with its bearings: itself where it repeats none.
std::vector<std::size_t> first_of_copies(const Matches& m);

// Chosen matches that are no copies of one another, or `enough` if there are more.
int count_distinct(const Matches& m, const unsigned char* chosen, int enough);

}  // namespace epi360
