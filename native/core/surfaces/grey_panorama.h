// SPDX-License-Identifier: BSD-3-Clause
// Brightness of a full panorama in a direction, sharp or blurred.
#pragma once

#include <algorithm>
#include <cmath>

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
  const float ratio = std::min(ax, ay) / std::max(std::max(ax, ay), 1e-20f);
  const float square = ratio * ratio;
  // Minimax polynomial of the arctangent on [0, 1], odd, of degree 7.
  float angle =
      ((-0.0464964749f * square + 0.15931422f) * square - 0.327622764f) * square * ratio + ratio;
  angle = ay > ax ? 1.57079637f - angle : angle;
  angle = x < 0.0f ? 3.14159274f - angle : angle;
  return y < 0.0f ? -angle : angle;
}

// Column and row, with fractions, of the pixel that a direction falls into.
EPI360_INLINE void pixel_of(const GreyPanorama& panorama, const Vec3f& direction, float* u,
                            float* v) {
  const float flat = std::sqrt(direction.x * direction.x + direction.z * direction.z);
  *u = (angle_of(direction.x, direction.z) * 0.159154943f + 0.5f) * panorama.width - 0.5f;
  *v = (angle_of(direction.y, flat) * 0.318309886f + 0.5f) * panorama.height - 0.5f;
}

EPI360_INLINE float value_at(const GreyPanorama& panorama, const unsigned char* level, float u,
                             float v) {
  const int width = panorama.width;
  // The constants come first: then what is no number becomes 0.
  const float row = std::min(std::max(0.0f, v), panorama.height - 1.001f);
  const float column = std::min(std::max(0.0f, u + 1.0f), static_cast<float>(width));
  const int i = static_cast<int>(column) - 1;
  const int j = std::min(static_cast<int>(row), panorama.height - 2);
  const float a = u - i, b = row - j;
  const int left = i < 0 ? i + width : (i >= width ? i - width : i);
  const int right = left + 1 < width ? left + 1 : 0;
  const unsigned char* above = level + static_cast<std::size_t>(j) * width;
  const unsigned char* below = above + width;
  return (1.0f - b) * ((1.0f - a) * above[left] + a * above[right]) +
         b * ((1.0f - a) * below[left] + a * below[right]);
}

}  // namespace epi360
