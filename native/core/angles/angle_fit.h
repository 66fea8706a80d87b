// SPDX-License-Identifier: BSD-3-Clause
// Changes of the cameras' angles with which matches agree better, together with a pose or a turn.
// estimation.angle_changes_reference is the twin.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "core/angles/changed_angles.h"
#include "core/pose.h"

namespace epi360 {

// Both views of some matches. One camera for both views has its changes once.
struct PairAngles {
  ViewAngles first, second;
  bool is_one_camera;

  int num_changes() const {
    return first.num_changes() + (is_one_camera ? 0 : second.num_changes());
  }
  // Where the changes of the second view begin.
  int second_begins() const { return is_one_camera ? 0 : first.num_changes(); }
};

using Changes = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 2 * kMostChanges, 1>;

// What the fit has at its end, of N matches and K = 5 + the changes; row by row.
struct AngleFit {
  RelativePose cam2_from_cam1;
  Changes changes;
  // Of the robust log-likelihood of the matches that agreed with the pose and the changes at the
  // start: among wrong matches, other angles always find some that agree.
  double gain;
  std::vector<double> residuals, jacobian;  // (N), (N, K): by the pose and by the changes
  std::vector<double> gradients1, gradients2, bearings1, bearings2;  // (N, 3) each
};

// Refines a pose, whose translation has length 1, together with the changes, from those of its
// start. `noise` is the standard deviation of the residuals of the inliers, in radians.
AngleFit fit_angle_changes(const PairAngles& angles, const RelativePose& start,
                           const Changes& start_changes, double noise);

// The changes with which a rotation near `rotation` explains most matches; none if no rotation
// does, or only with one of the largest changes.
std::optional<Changes> changed_by_a_turn(const PairAngles& angles, const Eigen::Matrix3d& rotation,
                                         double noise);

}  // namespace epi360
