// SPDX-License-Identifier: BSD-3-Clause
// Sums of products of small whole numbers, 16 bits each: many more a cycle than of floats.
#pragma once

#include <cstddef>
#include <cstdint>

namespace epi360 {

inline constexpr int kGroup = 8;   // rows that are multiplied at once with
inline constexpr int kPanel = 32;  // so many others, which lie together

// Whether this processor has the instruction for it, and the compiler knew it.
bool has_products();

// out[q * stride + x] = sum over components of rows[q] times the panel's row x, for all q below
// kGroup and x below kPanel. Components come in pairs: a row has 2 pairs numbers, and a panel the
// first pair of all its rows, then the second.
void multiply(const std::int16_t* rows, const std::int16_t* panel, int pairs, std::int32_t* out,
              std::ptrdiff_t stride);

}  // namespace epi360
