// SPDX-License-Identifier: BSD-3-Clause
#include "core/solvers/upright.h"

#include <cmath>

#include "core/solvers/polynomial.h"

namespace epi360 {
namespace {

// (1 + q^2) Ry(theta) b1 x b2 = c0 + c1 q + c2 q^2 with q = tan(theta / 2).
struct Quadratic {
  Eigen::Vector3d c[3];
};

Quadratic row_of(const Eigen::Vector3d& b1, const Eigen::Vector3d& b2) {
  const Eigen::Vector3d constant = Eigen::Vector3d(0.0, b1.y(), 0.0).cross(b2);
  const Eigen::Vector3d cosine = Eigen::Vector3d(b1.x(), 0.0, b1.z()).cross(b2);
  const Eigen::Vector3d sine = Eigen::Vector3d(b1.z(), 0.0, -b1.x()).cross(b2);
  return {{constant + cosine, 2.0 * sine, constant - cosine}};
}

Eigen::Vector3d at(const Quadratic& p, double q) { return (p.c[2] * q + p.c[1]) * q + p.c[0]; }

}  // namespace

Eigen::Matrix3d upright_from(const Eigen::Vector3d& gravity) {
  const Eigen::Vector3d down = gravity.normalized();
  if (down.y() < -1.0 + 1e-12) {  // upside down: the shortest turn to +y has no axis
    const Eigen::Matrix3d half_turn = Eigen::Vector3d(-1.0, -1.0, 1.0).asDiagonal();
    return upright_from(half_turn * down) * half_turn;
  }
  const double s = std::sqrt((1.0 + down.y()) * 2.0);
  const Eigen::Vector3d v = down.cross(Eigen::Vector3d::UnitY()) * (1.0 / s);
  return Eigen::Quaterniond(0.5 * s, v.x(), v.y(), v.z()).toRotationMatrix();
}

int upright_three_point(const Eigen::Matrix3d& bearings1, const Eigen::Matrix3d& bearings2,
                        const Eigen::Matrix3d& upright1, const Eigen::Matrix3d& upright2,
                        RelativePose* poses) {
  Quadratic rows[3];
  for (int i = 0; i < 3; ++i) {
    rows[i] = row_of(upright1 * bearings1.col(i), upright2 * bearings2.col(i));
  }
  // All rows are across t: their determinant, of degree six in q, vanishes.
  double det[7] = {0.0};
  for (int j = 0; j < 3; ++j) {
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3d normal = rows[1].c[j].cross(rows[2].c[k]);
      for (int i = 0; i < 3; ++i) det[i + j + k] += rows[0].c[i].dot(normal);
    }
  }
  // It has the factor 1 + q^2, which no real angle fulfils.
  const double square = det[4] - det[6];
  const double quartic[5] = {det[2] - square, det[3] - det[5], square, det[5], det[6]};
  double roots[4];
  const int num_roots = real_roots(quartic, 4, roots);
  int count = 0;
  for (int r = 0; r < num_roots; ++r) {
    const double q = roots[r];
    const Eigen::Vector3d a = at(rows[0], q), b = at(rows[1], q), c = at(rows[2], q);
    const Eigen::Vector3d candidates[3] = {a.cross(b), b.cross(c), c.cross(a)};
    int best = 0;
    for (int k = 1; k < 3; ++k) {
      if (candidates[k].squaredNorm() > candidates[best].squaredNorm()) best = k;
    }
    const double length = candidates[best].norm();
    if (!(length > 0.0) || !std::isfinite(length)) continue;
    const double scale = 1.0 / (1.0 + q * q);
    const double cosine = (1.0 - q * q) * scale, sine = 2.0 * q * scale;
    Eigen::Matrix3d turn;
    turn << cosine, 0.0, sine, 0.0, 1.0, 0.0, -sine, 0.0, cosine;
    poses[count].R = upright2.transpose() * turn * upright1;
    poses[count].t = upright2.transpose() * candidates[best] / length;
    ++count;
  }
  return count;
}

}  // namespace epi360
