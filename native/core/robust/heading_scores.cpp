// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/heading_scores.h"

#include <algorithm>
#include <cmath>

#include "core/block_sum.h"
#include "core/multiversion.h"

namespace epi360 {
namespace {

constexpr double kWrongParallax = 0.035;  // radians, of a match that still counts as in front

}  // namespace

LevelMatches::LevelMatches(std::size_t n) {
  const std::size_t padded = (n + kHeadingLanes - 1) / kHeadingLanes * kHeadingLanes;
  for (std::vector<double>* column : {&x1, &y1, &z1, &x2, &y2, &z2, &weight}) {
    column->assign(padded, 0.0);
  }
}

TurnedMatches::TurnedMatches(std::size_t n)
    : ax(n), az(n), nx(n), nz(n), depth1x(n), depth1z(n), depth2x(n), depth2z(n), limit(n) {}

EPI360_MULTIVERSION
void turn_matches(const LevelMatches& m, double heading, TurnedMatches& out) {
  const double c = std::cos(heading), s = std::sin(heading);
  for (std::size_t i = 0; i < m.padded(); ++i) {
    const double ax = c * m.x1[i] + s * m.z1[i], ay = m.y1[i], az = c * m.z1[i] - s * m.x1[i];
    const double bx = m.x2[i], by = m.y2[i], bz = m.z2[i];
    const double nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
    out.ax[i] = ax;
    out.az[i] = az;
    out.nx[i] = nx;
    out.nz[i] = nz;
    // Both depths are positive where t lies on the right sides: n x b and n x a.
    out.depth1x[i] = ny * bz - nz * by;
    out.depth1z[i] = nx * by - ny * bx;
    out.depth2x[i] = ny * az - nz * ay;
    out.depth2z[i] = nx * ay - ny * ax;
    out.limit[i] = -kWrongParallax * std::sqrt(nx * nx + ny * ny + nz * nz);
  }
}

EPI360_MULTIVERSION
void score_direction(const LevelMatches& m, const TurnedMatches& turned, double x, double z,
                     double reach, double* forth, double* back) {
  const double per_reach = 1.0 / (reach * reach);
  double sum1[kHeadingLanes] = {}, sum2[kHeadingLanes] = {};
  for (std::size_t start = 0; start < m.padded(); start += kHeadingLanes) {
    for (std::size_t lane = 0; lane < kHeadingLanes; ++lane) {
      const std::size_t i = start + lane;
      const double n = turned.nx[i] * x + turned.nz[i] * z;
      const double a = turned.ax[i] * x + turned.az[i] * z, b = m.x2[i] * x + m.z2[i] * z;
      const double r = std::max(0.0, 1.0 - per_reach * n * n / (2.0 + 1e-9 - a * a - b * b));
      const double gain = m.weight[i] * r * r;
      const double depth1 = turned.depth1x[i] * x + turned.depth1z[i] * z;
      const double depth2 = turned.depth2x[i] * x + turned.depth2z[i] * z;
      sum1[lane] += std::min(depth1, depth2) > turned.limit[i] ? gain : 0.0;
      sum2[lane] += -std::max(depth1, depth2) > turned.limit[i] ? gain : 0.0;
    }
  }
  *forth = lane_sum(sum1);
  *back = lane_sum(sum2);
}

}  // namespace epi360
