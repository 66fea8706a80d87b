// SPDX-License-Identifier: BSD-3-Clause
// A second pose that explains the matches about as well.
#pragma once

#include <optional>
#include <vector>

#include "core/matches.h"
#include "core/robust/candidates.h"

namespace epi360 {

// The likeliest pose that is truly different.
struct Rival {
  std::optional<RelativePose> cam2_from_cam1;  // none was found
  LossModel loss;                              // its mixture
  double evidence = 0.0;                       // its log-likelihood minus that of the best pose
  double plane_share = 0.0;                    // of the inliers on one plane
  bool has_twin = false;  // the inliers lie on a plane, which has a second pose by geometry
};

// covariance: that of the pose, whose uncertainty must not explain the difference.
Rival find_rival(const Matches& m, Candidates& candidates, const RelativePose& cam2_from_cam1,
                 const Eigen::Matrix<double, 5, 5>& covariance,
                 const std::vector<unsigned char>& inlier, double gate);

}  // namespace epi360
