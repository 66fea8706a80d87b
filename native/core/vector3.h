// SPDX-License-Identifier: BSD-3-Clause
// Three numbers in the plain loops, where Eigen must not be (see multiversion.h).
#pragma once

#include "core/matches.h"
#include "core/multiversion.h"

namespace epi360 {

// Copied number by number: GCC leaves a copy of a whole inside a larger struct in memory, and does
// not vectorise the loop around it.
struct Vec3 {
  double x, y, z;
  Vec3() = default;
  Vec3(double a, double b, double c) : x(a), y(b), z(c) {}
  Vec3(const Vec3& v) : x(v.x), y(v.y), z(v.z) {}
  Vec3& operator=(const Vec3& v) {
    x = v.x;
    y = v.y;
    z = v.z;
    return *this;
  }
};

EPI360_INLINE Vec3 operator+(const Vec3& a, const Vec3& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
EPI360_INLINE Vec3 operator-(const Vec3& a, const Vec3& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
EPI360_INLINE Vec3 operator*(double s, const Vec3& a) { return {s * a.x, s * a.y, s * a.z}; }

// s a + t b. With operators it would depend on the compiler which product is rounded.
EPI360_INLINE Vec3 combination(double s, const Vec3& a, double t, const Vec3& b) {
  return {s * a.x + t * b.x, s * a.y + t * b.y, s * a.z + t * b.z};
}

EPI360_INLINE double dot(const Vec3& a, const Vec3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

EPI360_INLINE Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// sum + a x b, added from left to right.
EPI360_INLINE Vec3 add_cross(const Vec3& sum, const Vec3& a, const Vec3& b) {
  return {sum.x + a.y * b.z - a.z * b.y, sum.y + a.z * b.x - a.x * b.z,
          sum.z + a.x * b.y - a.y * b.x};
}

// M v of a row-major matrix.
EPI360_INLINE Vec3 product(const double* M, const Vec3& v) {
  return {M[0] * v.x + M[1] * v.y + M[2] * v.z, M[3] * v.x + M[4] * v.y + M[5] * v.z,
          M[6] * v.x + M[7] * v.y + M[8] * v.z};
}

EPI360_INLINE Vec3 bearing1(const Matches& m, std::size_t i) { return {m.x1[i], m.y1[i], m.z1[i]}; }
EPI360_INLINE Vec3 bearing2(const Matches& m, std::size_t i) { return {m.x2[i], m.y2[i], m.z2[i]}; }

}  // namespace epi360
