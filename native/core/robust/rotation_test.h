// SPDX-License-Identifier: BSD-3-Clause
// Whether matches that agree on a pose with translation reject that the camera only turned.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "core/matches.h"

namespace epi360 {

// What neighbouring inliers are wrong by together: the share of them whose errors are independent,
// and the variance that a pose has fitted away, over that of one residual.
struct NeighbourErrors {
  double independent = 1.0, hidden = 0.0;
};

// Standard deviations by which they reject it, in two ways.
struct RotationTest {
  // The median angle of the inliers under the rotation that fits them best, against what noise of
  // their scale makes of it. The median does not see the near misses of real matches, nor the wrong
  // ones that passed the gate; nor what is near, where most is far away. What is displaced on one
  // side has no say where all the others surround the camera, also above and below it: the floor
  // would be displaced, too.
  double by_median = 0.0;
  // That shows in the inliers that the rotation leaves displaced: how many they are, and how many
  // more of such matches lie along the epipolar curves than displacements in any direction would.
  double by_displaced = 0.0;
  int num_displaced = 0;
  // Whether they lie around the camera. Something that passes, clouds and water lie on one side,
  // and are no motion of the camera.
  bool all_around = false;
};

// `rotation` is the one that explains most matches, `scale` the standard deviation of the residuals
// of the inliers, `gate` their largest.
RotationTest test_rotation(const Matches& m, const std::vector<unsigned char>& inlier,
                           const Eigen::Matrix3d& rotation, double scale, double gate,
                           const NeighbourErrors& errors);

}  // namespace epi360
