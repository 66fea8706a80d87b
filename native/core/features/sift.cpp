// SPDX-License-Identifier: BSD-3-Clause
#include "core/features/sift.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <tuple>

#include "core/features/extrema.h"
#include "core/features/region.h"
#include "core/features/scale_space.h"

namespace epi360 {
namespace {

struct Keypoint {
  float x, y, size, angle, strength;
  std::array<unsigned char, kDescriptorSize> descriptor;

  auto key() const { return std::make_tuple(x, y, -size, angle); }
};

bool is_masked(const Picture& picture, float x, float y) {
  if (picture.mask == nullptr) return false;
  const int column = std::clamp(static_cast<int>(std::lround(x)), 0, picture.width - 1);
  const int row = std::clamp(static_cast<int>(std::lround(y)), 0, picture.height - 1);
  return picture.mask[static_cast<std::size_t>(row) * picture.width + column] == 0;
}

// Whether the mask leaves anything of what extrema that start in rows [first, end) converge to.
bool is_searched(const Picture& picture, int first, int end, float pixel) {
  if (picture.mask == nullptr) return true;
  const auto row_at = [&](int y) {
    return std::clamp(static_cast<int>(std::floor(y * pixel)), 0, picture.height - 1);
  };
  const std::size_t width = picture.width;
  const unsigned char* from = picture.mask + row_at(first - kVisitRows) * width;
  const unsigned char* to = picture.mask + (row_at(end + kVisitRows) + 1) * width;
  return std::any_of(from, to, [](unsigned char value) { return value != 0; });
}

// Key points of an extremum: one for each orientation. pixel is that of the octave.
void add_keypoints(const Picture& picture, const Octave& octave, const Extremum& extremum,
                   float pixel, std::vector<Keypoint>& keypoints) {
  Keypoint point;
  point.x = extremum.x * pixel;
  point.y = extremum.y * pixel;
  if (is_masked(picture, point.x, point.y)) return;
  point.size = 2.0f * extremum.place.sigma * pixel;
  point.strength = extremum.strength;
  float angles[kMaxOrientations];
  const int count = orientations(octave, extremum.place, angles);
  for (int k = 0; k < count; ++k) {
    point.angle = angles[k];
    describe(octave, extremum.place, angles[k], point.descriptor.data());
    keypoints.push_back(point);
  }
}

void search_octave(const Picture& picture, Octave& octave, double contrast_threshold, float pixel,
                   std::vector<Keypoint>& keypoints) {
  ExtremumSearch search(octave, contrast_threshold);
  std::vector<Extremum> found;
  for (int first = 0; first < octave.height(); first += kBandRows) {
    const int end = first + kBandRows;
    const bool searched = is_searched(picture, first, end, pixel);
    octave.advance(first, searched);
    if (!searched) continue;
    found.clear();
    search.search_rows(first, end, found);
    for (const Extremum& e : found) add_keypoints(picture, octave, e, pixel, keypoints);
  }
}

// In order and without repetition: two extrema may converge to one.
SiftKeypoints sorted(const std::vector<Keypoint>& keypoints) {
  std::vector<std::size_t> order(keypoints.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(),
            [&](std::size_t a, std::size_t b) { return keypoints[a].key() < keypoints[b].key(); });
  const auto same = [&](std::size_t a, std::size_t b) {
    return keypoints[a].key() == keypoints[b].key();
  };
  order.erase(std::unique(order.begin(), order.end(), same), order.end());
  SiftKeypoints out;
  out.rows.reserve(4 * order.size());
  out.descriptors.reserve(kDescriptorSize * order.size());
  for (const std::size_t k : order) {
    const Keypoint& point = keypoints[k];
    for (const float value : {point.x, point.y, point.size, point.strength}) {
      out.rows.push_back(value);
    }
    out.descriptors.insert(out.descriptors.end(), point.descriptor.begin(), point.descriptor.end());
  }
  return out;
}

}  // namespace

SiftKeypoints find_sift(const Picture& picture, double contrast_threshold) {
  std::vector<Keypoint> keypoints;
  int width = 2 * picture.width, height = 2 * picture.height;
  const int octaves = static_cast<int>(std::lround(std::log2(std::min(width, height)) - 1.0));
  Octave::Source source = doubled_picture(picture.pixels, picture.width, picture.height);
  std::vector<float> memory;
  float pixel = 0.5f;
  for (int k = 0; k < octaves && std::min(width, height) > 0; ++k, pixel *= 2.0f) {
    Octave octave(width, height, std::move(source), memory);
    search_octave(picture, octave, contrast_threshold, pixel, keypoints);
    source = stored_rows(octave.take_next(), width / 2);
    width /= 2;
    height /= 2;
  }
  return sorted(keypoints);
}

}  // namespace epi360
