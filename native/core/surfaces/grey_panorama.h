// SPDX-License-Identifier: BSD-3-Clause
// Brightness of a full panorama in a direction, sharp or blurred.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "core/multiversion.h"

namespace epi360 {

struct Vec3f {
  float x, y, z;
};

EPI360_INLINE Vec3f operator+(const Vec3f& a, const Vec3f& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
EPI360_INLINE Vec3f operator-(const Vec3f& a, const Vec3f& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
EPI360_INLINE Vec3f operator*(float s, const Vec3f& a) { return {s * a.x, s * a.y, s * a.z}; }
EPI360_INLINE float dot(const Vec3f& a, const Vec3f& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
EPI360_INLINE Vec3f cross(const Vec3f& a, const Vec3f& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
EPI360_INLINE Vec3f unit(const Vec3f& a) {
  return (1.0f / std::max(std::sqrt(dot(a, a)), 1e-12f)) * a;
}

// Grey values, row by row, of one size: sharp, and blurred more and more.
struct GreyPanorama {
  static constexpr int kLevels = 4;
  const unsigned char* values;
  int width, height;

  const unsigned char* level(int number) const {
    return values + static_cast<std::size_t>(number) * width * height;
  }
};

// Angle of a vector in the plane to 1e-4 rad; without branches, so that loops of it vectorise.
EPI360_INLINE float angle_of(float y, float x) {
  const float ax = std::fabs(x), ay = std::fabs(y);
  // Of a sum the compiler makes one division; of a third maximum, two cases and two divisions.
  const float ratio = std::min(ax, ay) / (std::max(ax, ay) + 1e-20f);
  const float square = ratio * ratio;
  // Minimax polynomial of the arctangent on [0, 1], odd, of degree 7.
  float angle =
      ((-0.0464964749f * square + 0.15931422f) * square - 0.327622764f) * square * ratio + ratio;
  angle = ay > ax ? 1.57079637f - angle : angle;
  angle = x < 0.0f ? 3.14159274f - angle : angle;
  return std::copysign(angle, y);
}

// Directions; their number is a multiple of 16, for loops that take so many at once.
template <int room>
struct Rays {
  float x[room], y[room], z[room];

  EPI360_INLINE_LAMBDA void set(int k, const Vec3f& ray) {
    x[k] = ray.x;
    y[k] = ray.y;
    z[k] = ray.z;
  }
};

// Pixels above and to the left of where rays meet a panorama, and how far beyond these they do.
template <int room>
struct Places {
  std::int32_t pixel[room], to_right[room];  // to_right leads to the next column, or to the first
  float beyond_column[room], beyond_row[room];
};

template <int room>
EPI360_INLINE void find_places(const GreyPanorama& panorama, const Rays<room>& rays,
                               Places<room>& places) {
  const std::int32_t width = panorama.width, last = panorama.height - 2;
  const float columns = static_cast<float>(width), rows = static_cast<float>(panorama.height);
  for (int k = 0; k < room; ++k) {
    const float x = rays.x[k], y = rays.y[k], z = rays.z[k];
    const float u = (angle_of(x, z) * 0.159154943f + 0.5f) * columns - 0.5f;
    const float v = (angle_of(y, std::sqrt(x * x + z * z)) * 0.318309886f + 0.5f) * rows - 0.5f;
    // The constants come first: then what is no number becomes 0.
    const float row = std::min(std::max(0.0f, v), rows - 1.001f);
    const float column = std::min(std::max(0.0f, u + 1.0f), columns);
    const std::int32_t i = static_cast<std::int32_t>(column) - 1;
    const std::int32_t j = std::min(static_cast<std::int32_t>(row), last);
    places.beyond_column[k] = u - static_cast<float>(i);
    places.beyond_row[k] = row - static_cast<float>(j);
    const std::int32_t turn = i < 0 ? width : (i >= width ? -width : 0);
    places.pixel[k] = j * width + i + turn;
    places.to_right[k] = i + turn + 1 < width ? 1 : 1 - width;
  }
}

// Brightness where rays meet one level of a panorama.
template <int room>
EPI360_INLINE void values_along(const GreyPanorama& panorama, const unsigned char* level,
                                const Rays<room>& rays, float* values) {
  Places<room> places;
  find_places(panorama, rays, places);
  // No processor loads bytes from many places at once fast, so this loop is one by one.
  unsigned char corners[4][room];
  for (int k = 0; k < room; ++k) {
    const unsigned char* above = level + places.pixel[k];
    const unsigned char* below = above + panorama.width;
    corners[0][k] = *above;
    corners[1][k] = above[places.to_right[k]];
    corners[2][k] = *below;
    corners[3][k] = below[places.to_right[k]];
  }
  for (int k = 0; k < room; ++k) {
    const float a = places.beyond_column[k], b = places.beyond_row[k];
    values[k] = (1.0f - b) * ((1.0f - a) * corners[0][k] + a * corners[1][k]) +
                b * ((1.0f - a) * corners[2][k] + a * corners[3][k]);
  }
}

}  // namespace epi360
