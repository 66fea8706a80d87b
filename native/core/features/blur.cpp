// SPDX-License-Identifier: BSD-3-Clause
#include "core/features/blur.h"

#include <cmath>
#include <stdexcept>

#include "core/multiversion.h"

namespace epi360 {
namespace {

// The radius is a constant, so that the inner loop unrolls and sums stay in registers.
template <int kRadius>
EPI360_INLINE void add_rows(const float* weights, const float* const* rows, int width,
                            float* __restrict out) {
  const float* below[kRadius];
  const float* above[kRadius];
  for (int t = 0; t < kRadius; ++t) {
    above[t] = rows[kRadius - 1 - t];
    below[t] = rows[kRadius + 1 + t];
  }
  const float* middle = rows[kRadius];
  for (int x = 0; x < width; ++x) {
    float sum = weights[0] * middle[x];
    for (int t = 0; t < kRadius; ++t) sum += weights[t + 1] * (above[t][x] + below[t][x]);
    out[x] = sum;
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
EPI360_INLINE void blur(const float* weights, const float* const* rows, int width, float* scratch,
                        float* out) {
  float* middle = scratch + kRadius;
  add_rows<kRadius>(weights, rows, width, middle);
  for (int t = 1; t <= kRadius; ++t) {
    middle[-t] = middle[reflected(-t, width)];
    middle[width - 1 + t] = middle[reflected(width - 1 + t, width)];
  }
  add_columns<kRadius>(weights, middle, width, out);
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

EPI360_MULTIVERSION
void blur_row(const GaussianKernel& kernel, const float* const* rows, int width, float* scratch,
              float* out) {
  const float* weights = kernel.weights.data();
  switch (kernel.radius()) {
    case 5:
      return blur<5>(weights, rows, width, scratch, out);
    case 6:
      return blur<6>(weights, rows, width, scratch, out);
    case 8:
      return blur<8>(weights, rows, width, scratch, out);
    case 10:
      return blur<10>(weights, rows, width, scratch, out);
    case 13:
      return blur<13>(weights, rows, width, scratch, out);
    default:
      throw std::invalid_argument("no filter of this radius");
  }
}

}  // namespace epi360
