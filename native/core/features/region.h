// SPDX-License-Identifier: BSD-3-Clause
// What SIFT says of the region around a key point: its orientations and its descriptor.
// Lowe, IJCV 2004, sections 5 and 6.
#pragma once

#include "core/features/scale_space.h"

namespace epi360 {

// A place in an octave. Angles are those of the brightness gradient, in degrees, counter-clockwise
// as the picture is seen.
struct Place {
  int level, x, y;
  float sigma;  // in pixels of the octave
};

inline constexpr int kMaxOrientations = 18;  // every second bin may be a peak
inline constexpr int kDescriptorSize = 128;

// Writes the angles of the region's main gradients, and returns how many there are.
int orientations(const Octave& octave, const Place& place, float* angles);

void describe(const Octave& octave, const Place& place, float angle, unsigned char* descriptor);

}  // namespace epi360
