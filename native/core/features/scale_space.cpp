// SPDX-License-Identifier: BSD-3-Clause
#include "core/features/scale_space.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>

namespace epi360 {
namespace {

constexpr double kSigmaOfPicture = 0.5;  // blur that any picture is taken to have

// Rows of the doubled picture, and the last of them that a blurred row needs.
class DoubledPicture {
 public:
  DoubledPicture(const unsigned char* picture, int width, int height)
      : picture_(picture),
        width_(width),
        height_(height),
        kernel_(std::sqrt(kFirstSigma * kFirstSigma - 4.0 * kSigmaOfPicture * kSigmaOfPicture)),
        ring_(static_cast<std::size_t>(kRows) * 2 * width),
        scratch_(scratch_size(2 * width)) {}

  void write(int y, int count, float* const* out) {
    const int radius = kernel_.radius();
    for (; made_ < std::min(2 * height_, y + count + radius); ++made_) make(made_);
    const float* rows[2 * kLargestBlurRadius + kBlurRows];
    for (int t = -radius; t < radius + count; ++t) {
      rows[t + radius] = row(reflected(y + t, 2 * height_));
    }
    blur_rows(kernel_, rows, count, 2 * width_, scratch_.data(), out);
  }

 private:
  static constexpr int kRows = 16;
  float* row(int y) { return ring_.data() + static_cast<std::size_t>(y % kRows) * 2 * width_; }

  // Row y lies on the picture's row y / 2 or between it and the next.
  void make(int y) {
    const unsigned char* first = picture_ + static_cast<std::size_t>(y / 2) * width_;
    const unsigned char* second = y % 2 == 1 && y / 2 + 1 < height_ ? first + width_ : first;
    float* out = row(y);
    for (int x = 0; x + 1 < width_; ++x) {
      const float here = 0.5f * (first[x] + second[x]);
      out[2 * x] = here;
      out[2 * x + 1] = 0.5f * (here + 0.5f * (first[x + 1] + second[x + 1]));
    }
    out[2 * width_ - 2] = out[2 * width_ - 1] = 0.5f * (first[width_ - 1] + second[width_ - 1]);
  }

  const unsigned char* picture_;
  int width_, height_, made_ = 0;
  GaussianKernel kernel_;
  std::vector<float> ring_, scratch_;
};

}  // namespace

Octave::Octave(int width, int height, Source source, std::vector<float>& memory)
    : width_(width),
      height_(height),
      stride_((static_cast<std::size_t>(width) + 15) / 16 * 16 + 16),  // room for whole vectors
      source_(std::move(source)),
      scratch_(scratch_size(width)),
      next_(static_cast<std::size_t>(width / 2) * (height / 2)) {
  const double ratio = std::pow(2.0, 1.0 / kScaleLayers);
  double sigma = kFirstSigma;
  for (int level = 1; level < kScaleLevels; ++level, sigma *= ratio) {
    kernels_.emplace_back(sigma * std::sqrt(ratio * ratio - 1.0));
  }
  std::size_t size = 0, starts[kScaleLevels];
  for (int level = 0; level < kScaleLevels; ++level) {
    starts[level] = size;
    size += stride_ * std::min(kRingRows[level], height);
  }
  if (memory.size() < size) memory.resize(size);
  for (int level = 0; level < kScaleLevels; ++level) levels_[level] = memory.data() + starts[level];
}

void Octave::advance(int first, bool is_searched) {
  ensure(kScaleLayers, first + kBandRows + kReachRows);
  if (!is_searched) return;
  skip(kScaleLevels - 1, first - kVisitRows);
  ensure(kScaleLevels - 1, first + kBandRows + kVisitRows);
}

void Octave::ensure(int level, int rows) {
  rows = std::min(rows, height_);
  if (done_[level] >= rows) return;
  if (level > 0) ensure(level - 1, rows + kernels_[level - 1].radius());
  while (done_[level] < rows) {
    const int count = std::min(kBlurRows, rows - done_[level]);
    make_rows(level, done_[level], count);
    done_[level] += count;
  }
}

// Leaves out rows that nothing needs: those of the levels above, which the next octave does not
// begin with.
void Octave::skip(int level, int rows) {
  if (level <= kScaleLayers) return;
  done_[level] = std::max(done_[level], rows);
  skip(level - 1, rows - kernels_[level - 1].radius());
}

void Octave::make_rows(int level, int y, int count) {
  float* out[kBlurRows];
  for (int k = 0; k < count; ++k) out[k] = levels_[level] + offset(level, y + k);
  if (level == 0) {
    source_(y, count, out);
    return;
  }
  const GaussianKernel& kernel = kernels_[level - 1];
  const int radius = kernel.radius();
  const float* rows[2 * kLargestBlurRadius + kBlurRows];
  for (int t = -radius; t < radius + count; ++t) {
    rows[t + radius] = row(level - 1, reflected(y + t, height_));
  }
  blur_rows(kernel, rows, count, width_, scratch_.data(), out);
  if (level != kScaleLayers) return;
  for (int k = 0; k < count; ++k) keep_half(y + k, out[k]);
}

void Octave::keep_half(int y, const float* row) {
  if (y % 2 != 0 || y / 2 >= height_ / 2) return;
  float* half = next_.data() + static_cast<std::size_t>(y / 2) * (width_ / 2);
  for (int x = 0; x < width_ / 2; ++x) half[x] = row[2 * x];
}

Octave::Source doubled_picture(const unsigned char* picture, int width, int height) {
  auto doubled = std::make_shared<DoubledPicture>(picture, width, height);
  return [doubled](int y, int count, float* const* out) { doubled->write(y, count, out); };
}

Octave::Source stored_rows(std::vector<float> values, int width) {
  auto kept = std::make_shared<std::vector<float>>(std::move(values));
  return [kept, width](int y, int count, float* const* out) {
    for (int k = 0; k < count; ++k) {
      std::copy_n(kept->data() + static_cast<std::size_t>(y + k) * width, width, out[k]);
    }
  };
}

}  // namespace epi360
