// SPDX-License-Identifier: BSD-3-Clause
// Bundle adjustment on the sphere: poses and points of least robust angular error, by
// Levenberg-Marquardt on the poses after the points are eliminated (Schur complement).
#pragma once

#include <cstdint>
#include <vector>

#include "core/refinement/loss.h"

namespace epi360 {

// Observations are in the order of their points. Nothing is NaN.
struct Window {
  std::vector<double> rotations, translations;  // 9 (by rows) and 3 a frame: cam_from_world
  std::vector<double> points;                   // 3 each
  std::vector<unsigned char> free_frame;
  std::vector<std::uint32_t> frame, point;  // of each observation
  std::vector<double> bearings, weights;    // 3 and 1 an observation
  // Direction of gravity in each camera and its weight: one over the variance. May be empty.
  std::vector<double> gravity, gravity_weights;
  double world_gravity[3] = {0.0, 1.0, 0.0};

  std::size_t num_frames() const { return free_frame.size(); }
  std::size_t num_points() const { return points.size() / 3; }
};

struct WindowOptions {
  LossModel loss;      // of angles in units of the noise
  double noise = 1.0;  // radians
  int max_iterations = 20;
  double tolerance = 1e-6;  // relative decrease of the cost that counts as none
  bool points_free = true;
};

struct WindowReport {
  double cost = 0.0;  // in units of the noise's variance
  int num_iterations = 0;
  bool converged = false;
};

// Scratch memory, reused between calls.
struct WindowWorkspace {
  // Blocks of J^T W J and J^T W r: poses (6 x 6 and 6 a frame), points (3 x 3 as the upper triangle
  // and 3 each) and both (an observation's 6 x 3, transposed).
  std::vector<double> poses, pose_gradients, points, point_gradients, mixed;
  std::vector<double> inverses;             // of the points' damped blocks, 6 each
  std::vector<std::uint32_t> slot;          // of a frame among the free ones
  std::vector<std::size_t> first_column;    // of each row of the reduced system, before it zeros
  std::vector<std::uint32_t> first_seen;    // first observation of each point, and one past all
  std::vector<std::size_t> row_start;       // of each row of the reduced system
  std::vector<double> reduced, pose_steps;  // reduced: rows from their first column that is not zero
  std::vector<double> trial_rotations, trial_translations, trial_points;
};

WindowReport adjust(Window& window, const WindowOptions& options, WindowWorkspace& workspace);

}  // namespace epi360
