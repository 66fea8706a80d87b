// SPDX-License-Identifier: BSD-3-Clause
#include "core/paper/residuals.h"

#include <algorithm>
#include <cmath>

#include "core/block_sum.h"
#include "core/multiversion.h"

namespace epi360 {
namespace {

constexpr std::size_t kBlock = Matches::kBlock;

struct Plain3 {
  double entry[9];
};

EPI360_INLINE Plain3 copy_of(const double* values) {
  Plain3 m;
  std::copy(values, values + 9, m.entry);
  return m;
}

EPI360_INLINE double residual_of(const Matches& m, const Plain3& E, std::size_t i) {
  const double x = m.x1[i], y = m.y1[i], z = m.z1[i];
  const double nx = E.entry[0] * x + E.entry[1] * y + E.entry[2] * z;
  const double ny = E.entry[3] * x + E.entry[4] * y + E.entry[5] * z;
  const double nz = E.entry[6] * x + E.entry[7] * y + E.entry[8] * z;
  const double squared = nx * nx + ny * ny + nz * nz;
  // Zero at the epipole, where a quotient of zeros would poison all sums.
  return (m.x2[i] * nx + m.y2[i] * ny + m.z2[i] * nz) / std::sqrt(squared > 0.0 ? squared : 1.0);
}

}  // namespace

EPI360_MULTIVERSION
void essential_residuals(const Matches& m, const double* E, double* residuals) {
  const Plain3 plain = copy_of(E);
  double block[kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t j = 0; j < kBlock; ++j) block[j] = residual_of(m, plain, start + j);
    std::copy(block, block + kBlock, residuals + start);
  }
}

EPI360_MULTIVERSION
double absolute_residual_sum(const Matches& m, const double* E) {
  const Plain3 plain = copy_of(E);
  double block[kBlock], sum = 0.0;
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t j = 0; j < kBlock; ++j) {
      block[j] = m.weight[start + j] * std::fabs(residual_of(m, plain, start + j));
    }
    sum += block_sum(block);
  }
  return sum;
}

EPI360_MULTIVERSION
FrontCounts count_in_front(const Matches& m, const double* R, const double* t) {
  const Plain3 p = copy_of(R);
  const double tx = t[0], ty = t[1], tz = t[2];
  FrontCounts counts = {};
  double block[4][kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t j = 0; j < kBlock; ++j) {
      const std::size_t i = start + j;
      const double x = m.x1[i], y = m.y1[i], z = m.z1[i], w = m.weight[i];
      const double ax = p.entry[0] * x + p.entry[1] * y + p.entry[2] * z;
      const double ay = p.entry[3] * x + p.entry[4] * y + p.entry[5] * z;
      const double az = p.entry[6] * x + p.entry[7] * y + p.entry[8] * z;
      const double ta = tx * ax + ty * ay + tz * az;
      const double tb = tx * m.x2[i] + ty * m.y2[i] + tz * m.z2[i];
      const double c = ax * m.x2[i] + ay * m.y2[i] + az * m.z2[i];
      const double turned = 2.0 * ta * tb - c;  // R' b1 . b2; t . R' b1 is ta
      const double d1 = c * tb - ta, d2 = tb - c * ta;
      const double e1 = turned * tb - ta, e2 = tb - turned * ta;
      block[0][j] = (d1 > 0.0 ? w : 0.0) * (d2 > 0.0 ? 1.0 : 0.0);
      block[1][j] = (d1 < 0.0 ? w : 0.0) * (d2 < 0.0 ? 1.0 : 0.0);
      block[2][j] = (e1 > 0.0 ? w : 0.0) * (e2 > 0.0 ? 1.0 : 0.0);
      block[3][j] = (e1 < 0.0 ? w : 0.0) * (e2 < 0.0 ? 1.0 : 0.0);
    }
    for (int k = 0; k < 4; ++k) counts.matches[k] += block_sum(block[k]);
  }
  return counts;
}

}  // namespace epi360
