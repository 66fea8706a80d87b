// SPDX-License-Identifier: BSD-3-Clause
// Bearings and points as structure of arrays, and how well poses explain them.
#pragma once

#include <cstddef>
#include <vector>

namespace epi360 {

struct SeenPoints {
  std::size_t size = 0;
  std::vector<double> bx, by, bz, x, y, z;

  SeenPoints(const double* bearings, const double* points, std::size_t n);  // row-major (n, 3)
};

// Sum of min(chord^2, gate^2), where the chord between bearing and direction is nearly the angle,
// and how many chords are below the gate.
struct PoseScore {
  double cost;
  std::size_t num_inliers;
};

// R row-major.
PoseScore pose_score(const SeenPoints& seen, const double* R, const double* t, double gate);

// Chords of all.
void chords(const SeenPoints& seen, const double* R, const double* t, double* out);

}  // namespace epi360
