// SPDX-License-Identifier: BSD-3-Clause
#include "core/adjustment/pose_scores.h"

#include <algorithm>
#include <cmath>

#include "core/block_sum.h"

namespace epi360 {
namespace {

// |direction - bearing|^2: unlike 2 - 2 cos it keeps its digits near zero.
EPI360_INLINE double squared_chord(const SeenPoints& s, std::size_t i, const double* R,
                                   const double* t) {
  const double X = s.x[i], Y = s.y[i], Z = s.z[i];
  const double x = R[0] * X + R[1] * Y + R[2] * Z + t[0];
  const double y = R[3] * X + R[4] * Y + R[5] * Z + t[1];
  const double z = R[6] * X + R[7] * Y + R[8] * Z + t[2];
  const double scale = 1.0 / std::max(std::sqrt(x * x + y * y + z * z), 1e-300);
  const double dx = scale * x - s.bx[i], dy = scale * y - s.by[i], dz = scale * z - s.bz[i];
  return dx * dx + dy * dy + dz * dz;
}

}  // namespace

// Padded with bearings so long that no direction is near them.
SeenPoints::SeenPoints(const double* bearings, const double* points, std::size_t n) : size(n) {
  const std::size_t padded = (n + kLanes - 1) / kLanes * kLanes;
  std::vector<double>* columns[6] = {&bx, &by, &bz, &x, &y, &z};
  for (int k = 0; k < 6; ++k) {
    columns[k]->assign(padded, k < 3 ? 2.0 : 1.0);
    for (std::size_t i = 0; i < n; ++i) (*columns[k])[i] = (k < 3 ? bearings : points)[3 * i + k % 3];
  }
}

EPI360_MULTIVERSION
PoseScore pose_score(const SeenPoints& s, const double* R, const double* t, double gate) {
  const double limit = gate * gate;
  double costs[kLanes] = {0.0}, counts[kLanes] = {0.0};
  for (std::size_t start = 0; start < s.bx.size(); start += kLanes) {
    for (std::size_t j = 0; j < kLanes; ++j) {
      const double square = squared_chord(s, start + j, R, t);
      costs[j] += std::min(square, limit);
      counts[j] += square < limit ? 1.0 : 0.0;
    }
  }
  return {lane_sum(costs), static_cast<std::size_t>(lane_sum(counts))};
}

EPI360_MULTIVERSION
void chords(const SeenPoints& s, const double* R, const double* t, double* out) {
  for (std::size_t i = 0; i < s.size; ++i) out[i] = std::sqrt(squared_chord(s, i, R, t));
}

}  // namespace epi360
