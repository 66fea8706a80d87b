// SPDX-License-Identifier: BSD-3-Clause
#include "core/paper/weights.h"

#include <algorithm>
#include <cmath>

#include "core/block_sum.h"
#include "core/multiversion.h"
#include "core/vector_exp.h"

namespace epi360 {
namespace {

constexpr std::size_t kBlock = Matches::kBlock;
constexpr double kFreedom = 5.0;  // of Student's t
constexpr int kRounds = 20;       // of its scale's fixed point

EPI360_INLINE double mean_of(const Matches& m, const double* residuals) {
  double sum = 0.0, term[kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t j = 0; j < kBlock; ++j) term[j] = m.weight[start + j] * residuals[start + j];
    sum += block_sum(term);
  }
  return sum / static_cast<double>(m.size);
}

EPI360_INLINE double variance_of(const Matches& m, const double* residuals, double mean) {
  double sum = 0.0, term[kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t j = 0; j < kBlock; ++j) {
      const double e = residuals[start + j] - mean;
      term[j] = m.weight[start + j] * e * e;
    }
    sum += block_sum(term);
  }
  return sum / static_cast<double>(m.size);
}

EPI360_MULTIVERSION
void gaussian_weights(const Matches& m, const double* residuals, double* weights) {
  const double mean = mean_of(m, residuals), variance = variance_of(m, residuals, mean);
  // All residuals equal: nothing tells them apart.
  const double factor = variance > 0.0 ? -0.5 / variance : 0.0;
  double block[kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t j = 0; j < kBlock; ++j) {
      const double e = residuals[start + j] - mean;
      block[j] = m.weight[start + j] * vector_exp(e * e * factor);
    }
    std::copy(block, block + kBlock, weights + start);
  }
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
  double sum = 0.0, term[kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t j = 0; j < kBlock; ++j) {
      term[j] = weights[start + j] * residuals[start + j] * residuals[start + j];
    }
    sum += block_sum(term);
  }
  return sum;
}

}  // namespace epi360
