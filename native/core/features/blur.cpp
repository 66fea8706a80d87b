// SPDX-License-Identifier: BSD-3-Clause
#include "core/features/blur.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "core/multiversion.h"

namespace epi360 {
namespace {

constexpr int kLeft = 16;  // room for the largest radius, and whole vectors

// Sums of kBlurRows rows, which lie stride numbers apart: they share most of what they read. The
// radius is a constant, so that the inner loop unrolls and sums stay in registers.
template <int kRadius>
EPI360_INLINE void add_rows(const float* weights, const float* const* rows, int width,
                            std::size_t stride, float* __restrict sums) {
  static_assert(kBlurRows == 4);
  const float* in[2 * kRadius + 4];
  for (int t = 0; t < 2 * kRadius + 4; ++t) in[t] = rows[t];
  const float* const* middle = in + kRadius;
  for (int x = 0; x < width; ++x) {
    float a = weights[0] * middle[0][x], b = weights[0] * middle[1][x];
    float c = weights[0] * middle[2][x], d = weights[0] * middle[3][x];
    EPI360_UNROLL
    for (int t = 1; t <= kRadius; ++t) {
      a += weights[t] * (middle[-t][x] + middle[t][x]);
      b += weights[t] * (middle[1 - t][x] + middle[1 + t][x]);
      c += weights[t] * (middle[2 - t][x] + middle[2 + t][x]);
      d += weights[t] * (middle[3 - t][x] + middle[3 + t][x]);
    }
    sums[x] = a;
    sums[x + stride] = b;
    sums[x + 2 * stride] = c;
    sums[x + 3 * stride] = d;
  }
}

template <int kRadius>
EPI360_INLINE void add_columns(const float* weights, const float* in, int width,
                               float* __restrict out) {
  for (int x = 0; x < width; ++x) {
    float sum = weights[0] * in[x];
    for (int t = 1; t <= kRadius; ++t) sum += weights[t] * (in[x - t] + in[x + t]);
    out[x] = sum;
  }
}

template <int kRadius>
EPI360_INLINE void blur(const float* weights, const float* const* rows, int count, int width,
                        float* scratch, float* const* out) {
  const float* in[2 * kRadius + kBlurRows];  // rows that are too many repeat the last one
  for (int t = 0; t < 2 * kRadius + kBlurRows; ++t)
    in[t] = rows[std::min(t, 2 * kRadius + count - 1)];
  const std::size_t stride = scratch_size(width) / kBlurRows;
  add_rows<kRadius>(weights, in, width, stride, scratch + kLeft);
  for (int k = 0; k < count; ++k) {
    float* middle = scratch + k * stride + kLeft;
    for (int t = 1; t <= kRadius; ++t) {
      middle[-t] = middle[reflected(-t, width)];
      middle[width - 1 + t] = middle[reflected(width - 1 + t, width)];
    }
    add_columns<kRadius>(weights, middle, width, out[k]);
  }
}

}  // namespace

GaussianKernel::GaussianKernel(double sigma) {
  const int radius = static_cast<int>(std::lround(8.0 * sigma + 1.0) | 1) / 2;  // as OpenCV
  if (radius > kLargestBlurRadius) throw std::invalid_argument("sigma is too large");
  double sum = 0.0;
  std::vector<double> values(radius + 1);
  for (int t = 0; t <= radius; ++t) {
    values[t] = std::exp(-0.5 * t * t / (sigma * sigma));
    sum += t == 0 ? values[t] : 2.0 * values[t];
  }
  for (const double value : values) weights.push_back(static_cast<float>(value / sum));
}

EPI360_MULTIVERSION_WIDE
void blur_rows(const GaussianKernel& kernel, const float* const* rows, int count, int width,
               float* scratch, float* const* out) {
  const float* weights = kernel.weights.data();
  switch (kernel.radius()) {
    case 5:
      return blur<5>(weights, rows, count, width, scratch, out);
    case 6:
      return blur<6>(weights, rows, count, width, scratch, out);
    case 8:
      return blur<8>(weights, rows, count, width, scratch, out);
    case 10:
      return blur<10>(weights, rows, count, width, scratch, out);
    case 13:
      return blur<13>(weights, rows, count, width, scratch, out);
    default:
      throw std::invalid_argument("no filter of this radius");
  }
}

}  // namespace epi360
