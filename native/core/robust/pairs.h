// SPDX-License-Identifier: BSD-3-Clause
// The robust estimator on raw arrays: many pairs on a few threads.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/robust/estimate.h"

namespace epi360 {

// Row-major arrays of n matches: bearings (n, 3) of any length, NaN rows are missing; the rest may
// be null: weights (n), scores (n), Jacobians (n, 3, 2), gravity (3) in both cameras.
struct PairInput {
  std::size_t n = 0;
  const double* bearings1 = nullptr;
  const double* bearings2 = nullptr;
  const double* weights = nullptr;
  const double* scores = nullptr;
  const double* jacobians1 = nullptr;
  const double* jacobians2 = nullptr;
  const double* gravity1 = nullptr;
  const double* gravity2 = nullptr;
  double gravity_sigma = 0.0, elevation_sigma = 0.0;  // radians, see PosePrior
  std::uint64_t seed = 0;
  // Radians: the bearings are no better than this, however well some agree; 0 is no limit.
  double min_noise = 0.0;
  double max_noise = 0.0;  // see MatchPriors
};

// A row of view 1 or 2 that is infinite or of zero length; view 0 where there is none.
struct BadRow {
  int view = 0;
  std::size_t row = 0;
  bool is_infinite = false;
};

struct PairResult {
  RobustResult robust;   // inlier and residuals have one entry per row
  BadRow bad_row;        // with one there is no result
  double seconds = 0.0;  // wall time of the estimate, on one thread
};

// The results do not depend on the number of threads.
std::vector<PairResult> estimate_pairs(const std::vector<PairInput>& pairs,
                                       const RobustOptions& options, int num_threads);

}  // namespace epi360
