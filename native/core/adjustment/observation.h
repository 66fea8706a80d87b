// SPDX-License-Identifier: BSD-3-Clause
// One bearing against one point: the angle between them and its derivatives by the point.
#pragma once

#include <cmath>

#include "core/refinement/loss.h"
#include "core/vector3.h"

namespace epi360 {

// R X + t of a row-major rotation.
EPI360_INLINE Vec3 in_camera(const double* R, const double* t, const Vec3& X) {
  return {R[0] * X.x + R[1] * X.y + R[2] * X.z + t[0], R[3] * X.x + R[4] * X.y + R[5] * X.z + t[1],
          R[6] * X.x + R[7] * X.y + R[8] * X.z + t[2]};
}

struct Sight {
  Vec3 direction, across;  // to the point, unit; its tangent there away from the bearing
  double distance, cosine, square, angle;  // square is that of `across`, the sine
};

// The bearing is a unit vector. The angle keeps all digits near 0 and near pi.
EPI360_INLINE Sight sight(const Vec3& bearing, const Vec3& x) {
  Sight s;
  const double length = std::sqrt(dot(x, x));
  s.distance = length > 1e-300 ? length : 1e-300;
  s.direction = (1.0 / s.distance) * x;
  s.cosine = dot(s.direction, bearing);
  s.across = s.cosine * s.direction - bearing;
  s.square = dot(s.across, s.across);
  s.angle = std::atan2(std::sqrt(s.square), s.cosine);
  return s;
}

// Gauss-Newton terms of half the squared angle by the point: J^T J = m (upper triangle by rows)
// and J^T r, of the residual in the tangent plane of the bearing (window_reference.py). There it
// is stretched by angle / sine across the great circle from the bearing to the point, and not
// along it, so no tangent basis is needed. Zero more than 90 degrees away.
EPI360_INLINE void curvature(const Sight& s, double weight, double* m, Vec3* gradient) {
  const bool small = s.square < 1e-8;
  const double safe = small ? 1.0 : s.square;
  const double stretch = small ? 1.0 + s.square / 6.0 : s.angle / std::sqrt(safe);
  const double squared = stretch * stretch;
  // (1 - stretch^2) / sine^2, by its series near zero.
  const double along = small ? -1.0 / 3.0 - s.square * (8.0 / 45.0) : (1.0 - squared) / safe;
  const double scale = s.cosine > 0.0 ? weight / (s.distance * s.distance) : 0.0;
  const double a = scale * squared, b = scale * along;
  const Vec3 &u = s.direction, &q = s.across;
  m[0] = a * (1.0 - u.x * u.x) + b * q.x * q.x;
  m[1] = b * q.x * q.y - a * u.x * u.y;
  m[2] = b * q.x * q.z - a * u.x * u.z;
  m[3] = a * (1.0 - u.y * u.y) + b * q.y * q.y;
  m[4] = b * q.y * q.z - a * u.y * u.z;
  m[5] = a * (1.0 - u.z * u.z) + b * q.z * q.z;
  *gradient = (s.cosine > 0.0 ? weight * stretch / s.distance : 0.0) * q;
}

}  // namespace epi360
