// SPDX-License-Identifier: BSD-3-Clause
#include "core/features/region.h"

#include <algorithm>
#include <cmath>

#include "core/eight.h"
#include "core/multiversion.h"

namespace epi360 {
namespace {

constexpr int kAngleBins = 36;
constexpr int kLargestRadius = 40;
constexpr int kLanes = 8;
constexpr int kRowLength = 2 * kLargestRadius + 1 + kLanes;
constexpr int kSide = 4, kBins = 8;  // of a descriptor: 4 x 4 histograms of 8 directions
constexpr float kBinNumbers[kBins] = {0, 1, 2, 3, 4, 5, 6, 7};
constexpr int kCells = (kSide + 2) * (kSide + 2);  // with those around, which are not kept

// Angle of (x, y) in turns, in [0, 1]; its error is below 0.0002 turns. The polynomial is OpenCV's.
EPI360_INLINE float turns(float y, float x) {
  const float ax = std::abs(x), ay = std::abs(y);
  const float c = std::min(ax, ay) / (std::max(ax, ay) + 1e-12f), c2 = c * c;
  float a = (((-0.04432655554792128f * c2 + 0.1555786518463281f) * c2 - 0.3258083974640975f) * c2 +
             0.9997878412794807f) *
            c * 0.15915494309189535f;
  a = ay > ax ? 0.25f - a : a;
  a = x < 0.0f ? 0.5f - a : a;
  return y < 0.0f ? 1.0f - a : a;
}

// Whole vectors: the rest of a row by itself would cost as much as a vector for each pixel. Octaves
// have room for it behind each row.
EPI360_INLINE int whole_vectors(int count) { return (count + kLanes - 1) / kLanes * kLanes; }

// Gradients at x = first .. first + count - 1 of a row.
EPI360_INLINE void gradients(const float* above, const float* here, const float* below, int first,
                             int count, float* magnitudes, float* angles) {
  for (int k = 0; k < count; ++k) {
    const int x = first + k;
    const float dx = here[x + 1] - here[x - 1], dy = above[x] - below[x];
    magnitudes[k] = std::sqrt(dx * dx + dy * dy);
    angles[k] = turns(dy, dx);
  }
}

EPI360_INLINE int peaks(const float* raw, float* angles) {
  float h[kAngleBins];
  const auto at = [&](int k) { return raw[(k + kAngleBins) % kAngleBins]; };
  for (int k = 0; k < kAngleBins; ++k) {
    h[k] = (at(k - 2) + at(k + 2)) * (1.0f / 16.0f) + (at(k - 1) + at(k + 1)) * (4.0f / 16.0f) +
           at(k) * (6.0f / 16.0f);
  }
  const float least = 0.8f * *std::max_element(h, h + kAngleBins);
  int count = 0;
  for (int k = 0; k < kAngleBins; ++k) {
    const float left = h[(k + kAngleBins - 1) % kAngleBins], right = h[(k + 1) % kAngleBins];
    if (!(h[k] > left && h[k] > right && h[k] >= least)) continue;
    float bin = k + 0.5f * (left - right) / (left - 2.0f * h[k] + right);
    bin = bin < 0.0f ? bin + kAngleBins : bin >= kAngleBins ? bin - kAngleBins : bin;
    angles[count++] = bin * (360.0f / kAngleBins);
  }
  return count;
}

// Columns j of a row for which low < j * slope + start < high, cut to [first, last].
EPI360_INLINE void narrow(float slope, float start, float low, float high, int& first, int& last) {
  if (std::abs(slope) < 1e-6f) {
    if (!(start > low && start < high)) last = first - 1;
    return;
  }
  const float a = (low - start) / slope, b = (high - start) / slope;
  first = std::max(first, static_cast<int>(std::ceil(std::min(a, b))));
  last = std::min(last, static_cast<int>(std::floor(std::max(a, b))));
}

// Where each gradient falls, and its shares in a cell, the next one (01), and those below (10, 11).
struct RowOfRegion {
  float bins[kRowLength], w00[kRowLength], w01[kRowLength], w10[kRowLength], w11[kRowLength];
  int cells[kRowLength];
};

// The turned grid of a descriptor's histograms; cosine and sine are in cells a pixel.
struct Frame {
  float cosine, sine, zero;
  int radius;
  float weights[kRowLength] = {};

  Frame(float sigma, float angle) {
    const float cell = 3.0f * sigma, radians = angle * 0.017453292519943295f;
    cosine = std::cos(radians) / cell;
    sine = std::sin(radians) / cell;
    zero = angle / 360.0f;
    radius = std::min(kLargestRadius, static_cast<int>(std::lround(cell * 1.4142135f * 2.5f)));
    for (int i = 0; i <= radius; ++i) {
      weights[radius + i] = weights[radius - i] = std::exp(-0.125f * i * i / (cell * cell));
    }
  }
};

// Where the gradients of row i from column first on fall.
EPI360_INLINE void locate_row(const Frame& frame, int i, int first, int count,
                              const float* magnitudes, const float* turned, RowOfRegion& row) {
  const float cosine = frame.cosine, sine = frame.sine, zero = frame.zero;
  const float* weights = frame.weights + frame.radius;
  for (int k = 0; k < count; ++k) {
    const float j = static_cast<float>(first + k);
    // One more than in Lowe's numbering, so that all are positive: 0 to 5.
    const float r = std::min(std::max(j * sine + i * cosine + 2.5f, 0.0f), 4.9999f);
    const float c = std::min(std::max(j * cosine - i * sine + 2.5f, 0.0f), 4.9999f);
    float o = turned[k] - zero;
    o = (o < 0.0f ? o + 1.0f : o) * kBins;
    const int r0 = static_cast<int>(r), c0 = static_cast<int>(c);
    const float fr = r - r0, fc = c - c0;
    row.bins[k] = o;
    const float w = magnitudes[k] * weights[first + k] * weights[i];
    const float w1 = w * fr, w0 = w - w1;
    row.w11[k] = w1 * fc;
    row.w10[k] = w1 - row.w11[k];
    row.w01[k] = w0 * fc;
    row.w00[k] = w0 - row.w01[k];
    row.cells[k] = (r0 * (kSide + 2) + c0) * kBins;
  }
}

// Shares of each gradient among its nearest bins. All eight directions of a histogram are added to
// at once: adding to two of them would wait for the last pixel's to be stored. For the same reason
// the four histograms stay in registers as long as neighbours fall between the same four.
template <typename Vector>
EPI360_INLINE void add_row(const RowOfRegion& row, int count, float* histograms) {
  constexpr int kRight = kBins, kDown = (kSide + 2) * kBins;
  Vector numbers;
  load(kBinNumbers, numbers);
  const Vector nothing = 0.0f * numbers;
  for (int k = 0; k < count;) {
    const int cell = row.cells[k];
    float* h = histograms + cell;
    Vector h00, h01, h10, h11;
    load(h, h00);
    load(h + kRight, h01);
    load(h + kDown, h10);
    load(h + kDown + kRight, h11);
    do {
      Vector distance = row.bins[k] - numbers;
      raise(distance, 0.0f - distance);
      lower(distance, static_cast<float>(kBins) - distance);
      Vector share = 1.0f - distance;
      raise(share, nothing);
      h00 += row.w00[k] * share;
      h01 += row.w01[k] * share;
      h10 += row.w10[k] * share;
      h11 += row.w11[k] * share;
    } while (++k < count && row.cells[k] == cell);
    store(h00, h);
    store(h01, h + kRight);
    store(h10, h + kDown);
    store(h11, h + kDown + kRight);
  }
}

void finish(const float* histograms, unsigned char* descriptor) {
  float values[kDescriptorSize];
  for (int r = 0; r < kSide; ++r) {
    for (int c = 0; c < kSide; ++c) {
      const float* h = histograms + ((r + 1) * (kSide + 2) + c + 1) * kBins;
      std::copy(h, h + kBins, values + (r * kSide + c) * kBins);
    }
  }
  float sum = 0.0f, clipped = 0.0f;
  for (const float v : values) sum += v * v;
  const float most = 0.2f * std::sqrt(sum);
  for (float& v : values) {
    v = std::min(v, most);
    clipped += v * v;
  }
  const float scale = 512.0f / std::max(std::sqrt(clipped), 1e-7f);
  for (int k = 0; k < kDescriptorSize; ++k) {
    descriptor[k] = static_cast<unsigned char>(std::min(255.0f, values[k] * scale + 0.5f));
  }
}

template <typename Vector>
EPI360_INLINE void describe_by(const Octave& octave, const Place& place, float angle,
                               unsigned char* descriptor) {
  const Frame frame(place.sigma, angle);
  const int radius = frame.radius;
  alignas(32) float histograms[kCells * kBins] = {};
  RowOfRegion row;
  float magnitudes[kRowLength], turned[kRowLength];
  for (int i = -radius; i <= radius; ++i) {
    const int y = place.y + i;
    if (y < 1 || y > octave.height() - 2) continue;
    int first = std::max(-radius, 1 - place.x);
    int last = std::min(radius, octave.width() - 2 - place.x);
    narrow(frame.cosine, -i * frame.sine, -2.5f, 2.5f, first, last);
    narrow(frame.sine, i * frame.cosine, -2.5f, 2.5f, first, last);
    const int count = last - first + 1;
    if (count <= 0) continue;
    const int whole = whole_vectors(count);
    gradients(octave.row(place.level, y - 1), octave.row(place.level, y),
              octave.row(place.level, y + 1), place.x + first, whole, magnitudes, turned);
    locate_row(frame, i, first, whole, magnitudes, turned, row);
    add_row<Vector>(row, count, histograms);
  }
  finish(histograms, descriptor);
}

#ifdef EPI360_CLONES
EPI360_MULTIVERSION_WIDE
void describe_by_eights(const Octave& octave, const Place& place, float angle,
                        unsigned char* descriptor) {
  describe_by<Eight>(octave, place, angle, descriptor);
}
#endif

}  // namespace

EPI360_MULTIVERSION_WIDE
int orientations(const Octave& octave, const Place& place, float* angles) {
  const int radius = static_cast<int>(std::lround(4.5f * place.sigma));
  float weights[kLargestRadius + 1], magnitudes[kRowLength], turned[kRowLength];
  const float spread = 1.5f * place.sigma;
  for (int i = 0; i <= radius; ++i) weights[i] = std::exp(-0.5f * i * i / (spread * spread));
  float histogram[kAngleBins + 1] = {};
  const int first = std::max(1, place.x - radius);
  const int last = std::min(octave.width() - 2, place.x + radius);
  for (int i = -radius; i <= radius; ++i) {
    const int y = place.y + i;
    if (y < 1 || y > octave.height() - 2) continue;
    gradients(octave.row(place.level, y - 1), octave.row(place.level, y),
              octave.row(place.level, y + 1), first, whole_vectors(last - first + 1), magnitudes,
              turned);
    const float weight = weights[std::abs(i)];
    for (int x = first; x <= last; ++x) {
      const int k = x - first;
      const int bin = static_cast<int>(turned[k] * kAngleBins + 0.5f);
      histogram[bin] += magnitudes[k] * weight * weights[std::abs(x - place.x)];
    }
  }
  histogram[0] += histogram[kAngleBins];
  return peaks(histogram, angles);
}

void describe(const Octave& octave, const Place& place, float angle, unsigned char* descriptor) {
#ifdef EPI360_CLONES
  static const bool has_eights = __builtin_cpu_supports("x86-64-v3");
  if (has_eights) return describe_by_eights(octave, place, angle, descriptor);
#endif
  describe_by<TwoFours>(octave, place, angle, descriptor);
}

}  // namespace epi360
