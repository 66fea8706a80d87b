// SPDX-License-Identifier: BSD-3-Clause
// How much matches say for a pose when neighbours are not independent witnesses.
//
// Wrong matches of real images come in structures: a door taken for another door, carpet for
// carpet. Whole neighbourhoods then agree with a pose, and with many poses near it. Two questions
// tell them from right ones. What would these bearings agree on if partners were exchanged within
// their neighbourhoods? Where that agrees as well, a match says nothing. And how many regions
// speak? A hundred matches on one door are one witness.
#pragma once

#include <cstdint>

#include "core/matches.h"
#include "core/pose.h"
#include "core/refinement/pose_prior.h"
#include "core/residuals/residuals.h"

namespace epi360 {

struct Testimony {
  // Log-likelihood of a mixture of right and wrong matches under the pose, minus that of wrong
  // matches alone, where wrong ones agree as exchanged neighbours do; every region counts once.
  double log_ratio = 0.0;
  // Standard deviation of the direction of translation (radians, over both components) if every
  // region counts once; at most that of knowing nothing.
  double direction_sigma = 0.0;
  double num_regions = 0.0, all_regions = 0.0;  // those that agree, and all
};

// All matches, or so many of them at random as are worth asking.
Matches witnesses(const Matches& m, std::uint64_t seed);

// scale, gate: standard deviation and limit of the inliers' residuals; density: of the residuals of
// wrong matches, per radian.
Testimony testimony(const Matches& m, Residual residual, const RelativePose& cam2_from_cam1,
                    double scale, double gate, double density, const PosePrior& prior,
                    std::uint64_t seed);

// Vote of each match: one for a region, and none, if gravity is known, for what both views see
// within 30 degrees of straight down. There a panorama shows what carries the camera, and seldom a
// piece of ground that both stand on; unless most matches lie there.
std::vector<double> votes_of(const Matches& m, const PosePrior& prior);

// The log-likelihood ratio alone, for a rotation without translation: scale and gate as above of
// the angles between R b1 and b2 over sqrt 2, `share` of wrong matches inside the gate.
double rotation_log_ratio(const Matches& m, const Eigen::Matrix3d& R, double scale, double gate,
                          double share, std::uint64_t seed);

}  // namespace epi360
