// SPDX-License-Identifier: BSD-3-Clause
// Gaussian filter of some rows of a picture, from the rows around them.
#pragma once

#include <cstddef>
#include <vector>

namespace epi360 {

// Half of a symmetric kernel: weights[0] is the middle's.
struct GaussianKernel {
  explicit GaussianKernel(double sigma);
  int radius() const { return static_cast<int>(weights.size()) - 1; }
  std::vector<float> weights;
};

inline constexpr int kLargestBlurRadius = 13;

// Index of a row or column beyond the border, reflected about the first or last one.
inline int reflected(int index, int size) {
  if (size == 1) return 0;
  while (index < 0 || index >= size) index = index < 0 ? -index : 2 * size - 2 - index;
  return index;
}

// Rows that are filtered together.
inline constexpr int kBlurRows = 4;

// Numbers that blur_rows needs besides.
inline std::size_t scratch_size(int width) {
  return kBlurRows * ((static_cast<std::size_t>(width) + 15) / 16 * 16 + 48);
}

// Filters count rows, at most kBlurRows, from rows[0 .. 2 radius + count - 1], of which
// rows[radius] is the first output's. What they are does not depend on count.
void blur_rows(const GaussianKernel& kernel, const float* const* rows, int count, int width,
               float* scratch, float* const* out);

}  // namespace epi360
