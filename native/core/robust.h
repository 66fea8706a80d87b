// SPDX-License-Identifier: BSD-3-Clause
// The robust two-view estimator: sampling, refinement, verdict.
#pragma once

#include <cstdint>
#include <vector>

#include "matches.h"
#include "pose.h"
#include "residuals.h"

namespace epi360 {

enum class Status {
  kOk,
  kTooFewMatches,
  kTooFewInliers,
  kPureRotation,
  kPlanarAmbiguous,
  kConcentratedInliers,
};

struct RobustOptions {
  Residual residual = Residual::kSampson;
  double threshold = 0.0;            // radians; 0: estimated from the data
  bool threshold_in_pixels = false;  // it is in pixels; for pairs with Jacobians
  int sample_size = 5;               // 5 or 8
  int min_iterations = 20;
  int max_iterations = 10000;
  double confidence = 0.99;
  std::uint64_t seed = 0;
};

struct RobustResult {
  Status status = Status::kTooFewMatches;
  RelativePose pose;
  double scale = 0.0;      // standard deviation of the inliers' residuals, radians
  double threshold = 0.0;  // radians
  std::vector<unsigned char> inlier;
  std::vector<double> residuals;
  int num_iterations = 0;
  double parallax = 0.0;        // radians, median over inliers
  double coverage = 0.0;        // share of the sphere's cells with an inlier
  double match_coverage = 0.0;  // ... with a match
  Eigen::Matrix<double, 5, 5> covariance = Eigen::Matrix<double, 5, 5>::Zero();
  std::vector<RelativePose> alternatives;
};

// What is known about the matches beyond their bearings.
struct MatchPriors {
  std::vector<double> scores;  // higher is better; empty if there are none
  bool has_gravity = false;
  Eigen::Vector3d gravity1 = Eigen::Vector3d::UnitY(), gravity2 = Eigen::Vector3d::UnitY();
};

RobustResult estimate_relative_pose(const Matches& m, const RobustOptions& options,
                                    const MatchPriors& priors = {});

}  // namespace epi360
