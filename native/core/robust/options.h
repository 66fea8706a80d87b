// SPDX-License-Identifier: BSD-3-Clause
// What the robust estimator is asked.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <vector>

#include "core/refinement/pose_prior.h"
#include "core/residuals/residuals.h"

namespace epi360 {

struct RobustOptions {
  Residual residual = Residual::kSampson;
  double threshold = 0.0;            // radians; 0: estimated from the data
  bool threshold_in_pixels = false;  // it is in pixels; for pairs with Jacobians
  int sample_size = 5;               // 5 or 8
  int min_iterations = 20;
  int max_iterations = 10000;
  double confidence = 0.99;
  int min_num_inliers = 0;  // under which no pose is believed
  // Standard deviation of what neighbouring matches are wrong by together, over that of one match.
  double shared_error = 0.0;
};

// The same, with so many samples at the most.
inline RobustOptions with_most_samples(RobustOptions options, int most) {
  options.max_iterations = std::min(options.max_iterations, most);
  options.min_iterations = std::min(options.min_iterations, options.max_iterations);
  return options;
}

// What is known about the matches beyond their bearings.
struct MatchPriors {
  std::vector<double> scores;  // higher is better; empty if there are none
  PosePrior pose;
  // Radians, of the bearings: more than that is worth a warning, and longer search; 0 for no limit.
  double max_noise = 0.0;
};

// The rows from which matches were made: all, and copies of others that were left out.
struct RowCounts {
  std::size_t given, copies;
};

}  // namespace epi360
