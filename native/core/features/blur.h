// SPDX-License-Identifier: BSD-3-Clause
// Gaussian filter of one row of a picture, from the rows around it.
#pragma once

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

// out[x], from rows[0 .. 2 radius], the middle one of which is out's; scratch holds
// width + 2 kLargestBlurRadius numbers.
void blur_row(const GaussianKernel& kernel, const float* const* rows, int width, float* scratch,
              float* out);

}  // namespace epi360
