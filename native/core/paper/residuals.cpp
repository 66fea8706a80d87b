// SPDX-License-Identifier: BSD-3-Clause
#include "core/paper/residuals.h"

#include <algorithm>
#include <cmath>

#include "core/block_sum.h"
#include "core/multiversion.h"
#include "core/vector3.h"
#include "core/vector_exp.h"

namespace epi360 {
namespace {

constexpr std::size_t kBlock = Matches::kBlock;
constexpr double kFreedom = 5.0;  // of Student's t
constexpr int kRounds = 20;       // of its scale's fixed point

EPI360_INLINE double residual_of(const Matches& m, const double* E, std::size_t i) {
  const Vec3 n = product(E, bearing1(m, i));
  const double squared = dot(n, n);
  // Zero at the epipole, where a quotient of zeros would poison all sums.
  return dot(bearing2(m, i), n) / std::sqrt(squared > 0.0 ? squared : 1.0);
}

EPI360_INLINE double mean_of(const Matches& m, const double* residuals) {
  const auto term = [&](std::size_t i) EPI360_INLINE_LAMBDA { return m.weight[i] * residuals[i]; };
  return sum_of_terms(m.padded, term) / static_cast<double>(m.size);
}

EPI360_INLINE double variance_of(const Matches& m, const double* residuals, double mean) {
  const auto term = [&](std::size_t i) EPI360_INLINE_LAMBDA {
    const double e = residuals[i] - mean;
    return m.weight[i] * e * e;
  };
  return sum_of_terms(m.padded, term) / static_cast<double>(m.size);
}

EPI360_MULTIVERSION
void gaussian_weights(const Matches& m, const double* residuals, double* weights) {
  const double mean = mean_of(m, residuals), variance = variance_of(m, residuals, mean);
  // All residuals equal: nothing tells them apart.
  const double factor = variance > 0.0 ? -0.5 / variance : 0.0;
  fill_blocks(m.padded, weights, [&](std::size_t i) EPI360_INLINE_LAMBDA {
    const double e = residuals[i] - mean;
    return m.weight[i] * vector_exp(e * e * factor);
  });
}

EPI360_MULTIVERSION
void student_t_weights(const Matches& m, const double* residuals, double* weights) {
  double mean = mean_of(m, residuals), squared = variance_of(m, residuals, mean);
  double sum[kBlock], first[kBlock], second[kBlock];
  std::copy(m.weight.begin(), m.weight.end(), weights);  // where all residuals are equal
  for (int round = 0; round < kRounds && squared > 0.0; ++round) {
    double total = 0.0, moment = 0.0, spread = 0.0;
    const double inverse = 1.0 / squared;
    for (std::size_t start = 0; start < m.padded; start += kBlock) {
      for (std::size_t j = 0; j < kBlock; ++j) {
        const double e = residuals[start + j] - mean;
        const double w = m.weight[start + j] * (kFreedom + 1.0) / (kFreedom + e * e * inverse);
        sum[j] = w;
        first[j] = w * e;
        second[j] = w * e * e;
      }
      std::copy(sum, sum + kBlock, weights + start);
      total += block_sum(sum);
      moment += block_sum(first);
      spread += block_sum(second);
    }
    squared = spread / static_cast<double>(m.size);
    mean += moment / total;
  }
}

}  // namespace

void residual_weights(const Matches& m, const double* residuals, Weighting kind, double* weights) {
  if (kind == Weighting::kStudentT) return student_t_weights(m, residuals, weights);
  gaussian_weights(m, residuals, weights);
}

EPI360_MULTIVERSION
double weighted_squares(const Matches& m, const double* residuals, const double* weights) {
  return sum_of_terms(m.padded, [&](std::size_t i) EPI360_INLINE_LAMBDA {
    return weights[i] * residuals[i] * residuals[i];
  });
}

EPI360_MULTIVERSION
void essential_residuals(const Matches& m, const double* E, double* residuals) {
  fill_blocks(m.padded, residuals,
              [&](std::size_t i) EPI360_INLINE_LAMBDA { return residual_of(m, E, i); });
}

EPI360_MULTIVERSION
double absolute_residual_sum(const Matches& m, const double* E) {
  return sum_of_terms(m.padded, [&](std::size_t i) EPI360_INLINE_LAMBDA {
    return m.weight[i] * std::fabs(residual_of(m, E, i));
  });
}

EPI360_MULTIVERSION
FrontCounts count_in_front(const Matches& m, const double* R, const double* t) {
  const Vec3 direction{t[0], t[1], t[2]};
  FrontCounts counts = {};
  double block[4][kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t j = 0; j < kBlock; ++j) {
      const std::size_t i = start + j;
      const Vec3 a = product(R, bearing1(m, i)), b = bearing2(m, i);
      const double ta = dot(direction, a), tb = dot(direction, b), c = dot(a, b);
      const double w = m.weight[i];
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
