// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>

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

}  // namespace epi360
