// SPDX-License-Identifier: BSD-3-Clause
// One octave of SIFT's scale space, row by row: rows that are no longer needed are overwritten, so
// that the octave stays in the cache and memory does not grow with the height of the picture.
#pragma once

#include <functional>
#include <vector>

#include "core/features/blur.h"

namespace epi360 {

inline constexpr int kScaleLayers = 3;  // scales of an octave on which key points are found
inline constexpr int kScaleLevels = kScaleLayers + 3;
inline constexpr double kFirstSigma = 1.6;
inline constexpr int kBandRows = 16;
// Rows beyond a key point's that its region may reach, and that refining it may visit.
inline constexpr int kReachRows = 46, kVisitRows = 8;

class Octave {
 public:
  // Writes count rows of the first level, from y on, at most kBlurRows.
  using Source = std::function<void(int y, int count, float* const* out)>;

  // Rows are kept in memory, which grows where it must: octaves use it one after the other, because
  // the system takes longer to give new memory than a small octave takes.
  Octave(int width, int height, Source source, std::vector<float>& memory);
  int width() const { return width_; }
  int height() const { return height_; }
  const float* row(int level, int y) const { return levels_[level] + offset(level, y); }

  // Makes all rows present that key points of [first, first + kBandRows) look at, or only those
  // that later ones will need. first grows.
  void advance(int first, bool is_searched);

  // Every second pixel of the level that has twice the first one's sigma, once all rows are made.
  std::vector<float> take_next() { return std::move(next_); }

 private:
  // Rows of each level that are kept: less of those where no regions are described.
  static constexpr int kRingRows[kScaleLevels] = {128, 128, 128, 128, 64, 32};
  std::size_t offset(int level, int y) const {
    return static_cast<std::size_t>(y & (kRingRows[level] - 1)) * stride_;
  }
  void ensure(int level, int rows);
  void skip(int level, int rows);
  void make_rows(int level, int y, int count);
  void keep_half(int y, const float* row);

  int width_, height_;
  std::size_t stride_;
  Source source_;
  std::vector<GaussianKernel> kernels_;  // from each level to the next
  float* levels_[kScaleLevels];
  int done_[kScaleLevels] = {};
  std::vector<float> scratch_, next_;
};

// First level of the first octave: the picture (8 bits) at twice its size, blurred.
Octave::Source doubled_picture(const unsigned char* picture, int width, int height);

// First level from numbers that are there.
Octave::Source stored_rows(std::vector<float> values, int width);

}  // namespace epi360
