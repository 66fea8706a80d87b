// SPDX-License-Identifier: BSD-3-Clause
// The robust estimator on raw arrays: one pair or many on a few threads.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "robust.h"

namespace epi360 {

// Row-major arrays of n matches: bearings (n, 3) of any length, NaN rows are missing; the rest may
// be null: weights (n), scores (n), Jacobians (n, 3, 2), gravity (3) in both cameras.
struct RawPair {
  std::size_t n = 0;
  const double* bearings1 = nullptr;
  const double* bearings2 = nullptr;
  const double* weights = nullptr;
  const double* scores = nullptr;
  const double* jacobians1 = nullptr;
  const double* jacobians2 = nullptr;
  const double* gravity1 = nullptr;
  const double* gravity2 = nullptr;
  std::uint64_t seed = 0;  // of the sampling, instead of the options'
};

// How many matches agree, and from how much of the sphere: one minus the length of the mean
// bearing is 0 for one direction and 0.06 for a cone of 40 degrees.
struct Support {
  int num_distinct = 0;
  double spread = 0.0, spread_of_matches = 0.0;
};

struct PairResult {
  RobustResult robust;  // inlier and residuals have one entry per row
  Support support;
  std::size_t num_usable = 0;
  double seconds = 0.0;  // wall time of the estimate, on one thread
  // A row of view 1 or 2 that is infinite or of zero length: then there is no result.
  int bad_view = 0;
  std::size_t bad_row = 0;
  bool is_infinite = false;
};

PairResult estimate_pair(const RawPair& raw, const RobustOptions& options);

// The same for each pair; the results do not depend on the number of threads.
std::vector<PairResult> estimate_pairs(const std::vector<RawPair>& pairs,
                                       const RobustOptions& options, int num_threads);

}  // namespace epi360
