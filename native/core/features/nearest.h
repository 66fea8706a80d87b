// SPDX-License-Identifier: BSD-3-Clause
// The two nearest among many descriptors, by the products of rounded ones.
#pragma once

#include <cstdint>
#include <vector>

namespace epi360 {

struct Descriptors {
  const float* values;  // count rows of size numbers in [-1, 1]
  int count, size;
};

// Of each query: the nearest target (of equal ones the first), its similarity, and the runner-up's.
// Of each target: the largest similarity to a query that another target is the nearest of. What is
// missing is -1.
struct Nearest {
  std::vector<std::int64_t> nearest;
  std::vector<float> best, second, others;
};

// Whether both sets can be compared here: this processor can, and no number is beyond its range.
bool can_compare(const Descriptors& queries, const Descriptors& targets);

// Numbers are rounded to multiples of 2^-11.
Nearest two_nearest(const Descriptors& queries, const Descriptors& targets);

}  // namespace epi360
