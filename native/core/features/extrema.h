// SPDX-License-Identifier: BSD-3-Clause
// Extrema of an octave's differences of Gaussians, in space and scale. Lowe, IJCV 2004, section 4.
#pragma once

#include <vector>

#include "core/features/region.h"
#include "core/features/scale_space.h"

namespace epi360 {

struct Extremum {
  Place place;
  float x, y;      // in pixels of the octave
  float strength;  // contrast, a share of the whole range of brightness
};

class ExtremumSearch {
 public:
  ExtremumSearch(const Octave& octave, double contrast_threshold);

  // Appends the extrema that start in rows [first, end), block of columns by block of columns: what
  // one needs stays in the nearest cache, and so does what is described afterwards in this order.
  void search_rows(int first, int end, std::vector<Extremum>& found);

 private:
  static constexpr int kColumns = 256, kRoom = kColumns + 16;  // of a block; with its neighbours
  static constexpr int kDifferences = kScaleLevels - 1;
  float* difference(int level, int y) { return differences_[level][y % 3]; }
  void subtract(int y, int left, int count);
  void search_row(int y, int left, int count, std::vector<Extremum>& found);
  bool refine(int level, int x, int y, Extremum* extremum) const;

  const Octave& octave_;
  float contrast_threshold_;
  float differences_[kDifferences][3][kRoom], most_[kDifferences + 1][kRoom],
      least_[kDifferences + 1][kRoom];
  unsigned char flags_[kRoom] = {};
};

}  // namespace epi360
