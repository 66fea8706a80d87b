// SPDX-License-Identifier: BSD-3-Clause
// Loops over whole blocks of matches. Results go through a local block: the compiler knows that it
// aliases nothing and vectorises.
#pragma once

#include <algorithm>
#include <cstddef>
#include <limits>

#include "core/matches.h"
#include "core/multiversion.h"

namespace epi360 {

// Loops add into so many lanes, so that the order of additions does not depend on the vector width.
constexpr std::size_t kLanes = 8;

EPI360_INLINE double lane_sum(const double* l) {
  return ((l[0] + l[4]) + (l[1] + l[5])) + ((l[2] + l[6]) + (l[3] + l[7]));
}

EPI360_INLINE double block_sum(const double* values) {
  double lanes[8];
  for (int j = 0; j < 8; ++j) lanes[j] = values[j];
  for (std::size_t i = 8; i < Matches::kBlock; i += 8) {
    for (int j = 0; j < 8; ++j) lanes[j] += values[i + j];
  }
  return lane_sum(lanes);
}

// Sum of term(i) for i < padded; stops at a block after which it is above the limit.
template <typename Term>
EPI360_INLINE double sum_of_terms(std::size_t padded, const Term& term,
                                  double limit = std::numeric_limits<double>::infinity()) {
  double total = 0.0, block[Matches::kBlock];
  for (std::size_t start = 0; start < padded && !(total > limit); start += Matches::kBlock) {
    for (std::size_t j = 0; j < Matches::kBlock; ++j) block[j] = term(start + j);
    total += block_sum(block);
  }
  return total;
}

// out[i] = value(i) for i < padded.
template <typename Value>
EPI360_INLINE void fill_blocks(std::size_t padded, double* out, const Value& value) {
  double block[Matches::kBlock];
  for (std::size_t start = 0; start < padded; start += Matches::kBlock) {
    for (std::size_t j = 0; j < Matches::kBlock; ++j) block[j] = value(start + j);
    std::copy(block, block + Matches::kBlock, out + start);
  }
}

}  // namespace epi360
