// SPDX-License-Identifier: BSD-3-Clause
// A second pose that explains the matches about as well, far away or near by.
#pragma once

#include <optional>
#include <vector>

#include "core/matches.h"
#include "core/robust/candidates.h"

namespace epi360 {

// Another optimum of the likelihood, beyond the uncertainty of the best one.
struct Rival {
  RelativePose cam2_from_cam1;
  LossModel loss;         // its mixture
  double evidence = 0.0;  // its log-likelihood minus that of the best pose
};

struct Rivals {
  // The likeliest one that is another motion, and those that are the same motion to a few degrees
  // or to its uncertainty, the likeliest first.
  std::optional<Rival> distant;
  std::vector<Rival> nearby;
  double plane_share = 0.0;  // of the inliers on one plane
  bool has_twin = false;     // the inliers lie on a plane, which has a second pose by geometry
};

// covariance: that of the pose, whose uncertainty must not explain the difference.
Rivals find_rivals(const Matches& m, Candidates& candidates, const RelativePose& cam2_from_cam1,
                   const Eigen::Matrix<double, 5, 5>& covariance,
                   const std::vector<unsigned char>& inlier, double gate);

// What it adds to the covariance of a pose that another one with this probability may be right: its
// second moment about the pose.
Eigen::Matrix<double, 5, 5> second_moment(const RelativePose& pose, const RelativePose& other,
                                          double probability);

}  // namespace epi360
