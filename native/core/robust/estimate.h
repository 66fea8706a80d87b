// SPDX-License-Identifier: BSD-3-Clause
// The robust two-view estimator: search, refinement, evidence, verdict.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "core/matches.h"
#include "core/pose.h"
#include "core/robust/options.h"
#include "core/robust/verdict.h"

namespace epi360 {

// Numbers that the matches do not determine are NaN, also in the poses.
struct RobustResult {
  static constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

  Verdict verdict;
  Evidence evidence;
  RelativePose cam2_from_cam1;
  double scale = kNaN;      // standard deviation of the inliers' residuals, radians
  double threshold = kNaN;  // radians
  std::vector<unsigned char> inlier;
  std::vector<double> residuals;
  double probability = 0.0;  // that the pose is right; of a rotation NaN
  int num_iterations = 0;
  double parallax = kNaN;  // radians, median over inliers
  Eigen::Matrix<double, 5, 5, Eigen::RowMajor> covariance =
      Eigen::Matrix<double, 5, 5, Eigen::RowMajor>::Zero();
  Eigen::Matrix<double, 3, 2, Eigen::RowMajor> translation_basis =
      Eigen::Matrix<double, 3, 2, Eigen::RowMajor>::Zero();
  std::vector<RelativePose> alternatives;
};

RobustResult estimate_relative_pose(const Matches& m, const RobustOptions& options,
                                    const MatchPriors& priors, std::uint64_t seed,
                                    const RowCounts& rows);

}  // namespace epi360
