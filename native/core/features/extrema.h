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

  // Appends the extrema that start in row y; rows come in ascending order.
  void search_row(int y, std::vector<Extremum>& found);

 private:
  static constexpr int kDifferences = kScaleLevels - 1;
  float* difference(int level, int y) {
    return differences_.data() + (static_cast<std::size_t>(level) * 3 + y % 3) * octave_.width();
  }
  bool refine(int level, int x, int y, Extremum* extremum) const;

  const Octave& octave_;
  float contrast_threshold_;
  int made_;
  std::vector<float> differences_, most_, least_;
  std::vector<unsigned char> flags_;
};

}  // namespace epi360
