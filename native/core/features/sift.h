// SPDX-License-Identifier: BSD-3-Clause
// SIFT key points and descriptors (Lowe, IJCV 2004) with the definitions and constants of OpenCV's
// cv::SIFT: doubled picture, three layers an octave, edge threshold 10.
#pragma once

#include <vector>

namespace epi360 {

struct Picture {
  const unsigned char* pixels;
  const unsigned char* mask;  // of the same size; null: all; key points where it is 0 are left out
  int width, height;
};

// Sorted by place, then size, then angle.
struct SiftKeypoints {
  std::vector<double> rows;  // x, y (the first pixel's centre is 0), size, strength of each
  std::vector<unsigned char> descriptors;  // 128 of each
};

SiftKeypoints find_sift(const Picture& picture, double contrast_threshold);

}  // namespace epi360
