// SPDX-License-Identifier: BSD-3-Clause
#include "core/features/extrema.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "core/multiversion.h"

namespace epi360 {
namespace {

constexpr int kBorder = 5;
constexpr int kMaxSteps = 5;
constexpr double kEdgeThreshold = 10.0;

EPI360_MULTIVERSION_WIDE
void subtract_rows(const float* a, const float* b, int width, float* __restrict out) {
  for (int x = 0; x < width; ++x) out[x] = a[x] - b[x];
}

// Largest and smallest of three rows.
EPI360_MULTIVERSION_WIDE
void range_of_rows(const float* a, const float* b, const float* c, int width,
                   float* __restrict most, float* __restrict least) {
  for (int x = 0; x < width; ++x) {
    most[x] = std::max(std::max(a[x], b[x]), c[x]);
    least[x] = std::min(std::min(a[x], b[x]), c[x]);
  }
}

// Marks values beyond the threshold that nothing around exceeds, except for the first and the last
// of count; most and least are the ranges of three levels, stride numbers apart.
EPI360_MULTIVERSION_WIDE
void mark_extrema(const float* values, const float* most, const float* least, int stride, int count,
                  float threshold, float* __restrict high, float* __restrict low,
                  unsigned char* __restrict flags) {
  for (int x = 0; x < count; ++x) {
    high[x] = std::max(std::max(most[x], most[x + stride]), most[x + 2 * stride]);
    low[x] = std::min(std::min(least[x], least[x + stride]), least[x + 2 * stride]);
  }
  for (int x = 1; x < count - 1; ++x) {
    const float top = std::max(std::max(high[x - 1], high[x + 1]), high[x]);
    const float bottom = std::min(std::min(low[x - 1], low[x + 1]), low[x]);
    const float v = values[x];
    const bool peak = (v > threshold) & (v >= top);
    const bool pit = (v < -threshold) & (v <= bottom);
    flags[x] = peak | pit;
  }
}

// Values of the differences around a place, and their derivatives by x, y and scale.
struct Neighbourhood {
  double value, gradient[3], xx, yy, ss, xy, xs, ys;

  Neighbourhood(const Octave& octave, int level, int x, int y) {
    float d[3][3][3];
    for (int s = 0; s < 3; ++s) {
      for (int r = 0; r < 3; ++r) {
        const float* upper = octave.row(level + s, y + r - 1) + x - 1;
        const float* lower = octave.row(level + s - 1, y + r - 1) + x - 1;
        for (int c = 0; c < 3; ++c) d[s][r][c] = (upper[c] - lower[c]) * (1.0f / 255.0f);
      }
    }
    value = d[1][1][1];
    gradient[0] = 0.5 * (d[1][1][2] - d[1][1][0]);
    gradient[1] = 0.5 * (d[1][2][1] - d[1][0][1]);
    gradient[2] = 0.5 * (d[2][1][1] - d[0][1][1]);
    xx = d[1][1][2] + d[1][1][0] - 2.0 * value;
    yy = d[1][2][1] + d[1][0][1] - 2.0 * value;
    ss = d[2][1][1] + d[0][1][1] - 2.0 * value;
    xy = 0.25 * (d[1][2][2] - d[1][2][0] - d[1][0][2] + d[1][0][0]);
    xs = 0.25 * (d[2][1][2] - d[2][1][0] - d[0][1][2] + d[0][1][0]);
    ys = 0.25 * (d[2][2][1] - d[2][0][1] - d[0][2][1] + d[0][0][1]);
  }

  // Where the quadratic's derivative vanishes: minus the inverse of the Hessian, by cofactors.
  bool stationary(double* offset) const {
    const double a = yy * ss - ys * ys, b = xs * ys - xy * ss, c = xy * ys - xs * yy;
    const double determinant = xx * a + xy * b + xs * c;
    if (determinant == 0.0) return false;
    const double e = xx * ss - xs * xs, f = xs * xy - xx * ys, g = xx * yy - xy * xy;
    const double* v = gradient;
    offset[0] = -(a * v[0] + b * v[1] + c * v[2]) / determinant;
    offset[1] = -(b * v[0] + e * v[1] + f * v[2]) / determinant;
    offset[2] = -(c * v[0] + f * v[1] + g * v[2]) / determinant;
    return true;
  }

  bool is_edge() const {
    const double trace = xx + yy, determinant = xx * yy - xy * xy;
    const double limit = (kEdgeThreshold + 1.0) * (kEdgeThreshold + 1.0) / kEdgeThreshold;
    return determinant <= 0.0 || trace * trace >= limit * determinant;
  }
};

}  // namespace

ExtremumSearch::ExtremumSearch(const Octave& octave, double contrast_threshold)
    : octave_(octave), contrast_threshold_(static_cast<float>(contrast_threshold)) {}

void ExtremumSearch::search_rows(int first, int end, std::vector<Extremum>& found) {
  first = std::max(first, kBorder);
  end = std::min(end, octave_.height() - kBorder);
  const int right = octave_.width() - kBorder;
  if (first >= end) return;
  for (int left = kBorder; left < right; left += kColumns) {
    const int count = std::min(kColumns, right - left) + 2;
    subtract(first - 1, left - 1, count);
    subtract(first, left - 1, count);
    for (int y = first; y < end; ++y) {
      subtract(y + 1, left - 1, count);
      search_row(y, left - 1, count, found);
    }
  }
}

void ExtremumSearch::subtract(int y, int left, int count) {
  for (int s = 0; s < kDifferences; ++s) {
    subtract_rows(octave_.row(s + 1, y) + left, octave_.row(s, y) + left, count, difference(s, y));
  }
}

void ExtremumSearch::search_row(int y, int left, int count, std::vector<Extremum>& found) {
  for (int s = 0; s < kDifferences; ++s) {
    range_of_rows(difference(s, y - 1), difference(s, y), difference(s, y + 1), count, most_[s],
                  least_[s]);
  }
  // Half of what is asked of the interpolated value: interpolation never doubles it.
  const float threshold = 0.5f * contrast_threshold_ / kScaleLayers * 255.0f;
  for (int layer = 1; layer <= kScaleLayers; ++layer) {
    mark_extrema(difference(layer, y), most_[layer - 1], least_[layer - 1], kRoom, count, threshold,
                 most_[kDifferences], least_[kDifferences], flags_);
    for (int x = 1; x < count - 1; ++x) {
      std::uint64_t eight;
      std::memcpy(&eight, flags_ + x, 8);
      if (eight == 0) {
        x += 7;
        continue;
      }
      Extremum extremum;
      if (flags_[x] != 0 && refine(layer, left + x, y, &extremum)) found.push_back(extremum);
    }
  }
}

bool ExtremumSearch::refine(int level, int x, int y, Extremum* extremum) const {
  const int first = y - kVisitRows + 2, last = y + kVisitRows - 2;  // rows that are present
  for (int step = 0; step < kMaxSteps; ++step) {
    const Neighbourhood around(octave_, level, x, y);
    double offset[3];
    if (!around.stationary(offset)) return false;
    const double largest =
        std::max(std::max(std::abs(offset[0]), std::abs(offset[1])), std::abs(offset[2]));
    if (largest < 0.5) {
      const double* v = around.gradient;
      const double contrast =
          std::abs(around.value + 0.5 * (v[0] * offset[0] + v[1] * offset[1] + v[2] * offset[2]));
      const float strength = static_cast<float>(contrast);
      if (strength * kScaleLayers < contrast_threshold_ || around.is_edge()) return false;
      const double scale = std::pow(2.0, (level + offset[2]) / kScaleLayers);
      extremum->place = {level, x, y, static_cast<float>(kFirstSigma * scale)};
      extremum->x = static_cast<float>(x + offset[0]);
      extremum->y = static_cast<float>(y + offset[1]);
      extremum->strength = strength;
      return true;
    }
    if (!(largest < 1e6)) return false;
    x += static_cast<int>(std::lround(offset[0]));
    y += static_cast<int>(std::lround(offset[1]));
    level += static_cast<int>(std::lround(offset[2]));
    if (level < 1 || level > kScaleLayers || x < kBorder || x >= octave_.width() - kBorder ||
        y < std::max(first, kBorder) || y > std::min(last, octave_.height() - kBorder - 1)) {
      return false;
    }
  }
  return false;
}

}  // namespace epi360
