// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>

#include "matches.h"
#include "multiversion.h"

namespace epi360 {

// Eight lanes, so that the order of additions does not depend on the vector width.
EPI360_INLINE double block_sum(const double* values) {
  double lanes[8];
  for (int j = 0; j < 8; ++j) lanes[j] = values[j];
  for (std::size_t i = 8; i < Matches::kBlock; i += 8) {
    for (int j = 0; j < 8; ++j) lanes[j] += values[i + j];
  }
  return ((lanes[0] + lanes[4]) + (lanes[1] + lanes[5])) +
         ((lanes[2] + lanes[6]) + (lanes[3] + lanes[7]));
}

}  // namespace epi360
