// SPDX-License-Identifier: BSD-3-Clause
#include "core/solvers/gram.h"

#include <cmath>

#include "core/block_sum.h"
#include "core/multiversion.h"

namespace epi360 {
namespace {

constexpr std::size_t kBlock = Matches::kBlock;

struct Products {
  double product[6][kBlock];
};

EPI360_INLINE void multiply_out(const double* x, const double* y, const double* z, Products& p) {
  for (std::size_t j = 0; j < kBlock; ++j) {
    p.product[0][j] = x[j] * x[j];
    p.product[1][j] = x[j] * y[j];
    p.product[2][j] = x[j] * z[j];
    p.product[3][j] = y[j] * y[j];
    p.product[4][j] = y[j] * z[j];
    p.product[5][j] = z[j] * z[j];
  }
}

EPI360_INLINE void scale(const double* weight, Products& p) {
  for (int k = 0; k < 6; ++k) {
    for (std::size_t j = 0; j < kBlock; ++j) p.product[k][j] *= weight[j];
  }
}

// Lanes are added in a fixed order, whatever the vector width.
struct Lanes {
  double entry[36][kLanes];
};

EPI360_INLINE void accumulate_products(const Products& p1, const Products& p2, Lanes& lanes) {
  for (int k = 0; k < 6; ++k) {
    for (int l = 0; l < 6; ++l) {
      const double* a = p2.product[k];
      const double* b = p1.product[l];
      double* sum = lanes.entry[6 * k + l];
      for (std::size_t i = 0; i < kLanes; ++i) {
        sum[i] +=
            (a[i] * b[i] + a[i + 8] * b[i + 8]) + (a[i + 16] * b[i + 16] + a[i + 24] * b[i + 24]);
      }
    }
  }
}

EPI360_INLINE GramSums sum_of(const Lanes& lanes) {
  GramSums g;
  for (int k = 0; k < 36; ++k) {
    g.sums[k] = lane_sum(lanes.entry[k]);
  }
  return g;
}

EPI360_INLINE void transform(const double* N, const double* x, const double* y, const double* z,
                             double (*out)[kBlock]) {
  for (int r = 0; r < 3; ++r) {
    for (std::size_t j = 0; j < kBlock; ++j) {
      out[r][j] = N[3 * r] * x[j] + N[3 * r + 1] * y[j] + N[3 * r + 2] * z[j];
    }
  }
}

EPI360_INLINE double weighted_sum(const double* x, const double* w) {
  double term[kBlock];
  for (std::size_t j = 0; j < kBlock; ++j) term[j] = w[j] * x[j];
  return block_sum(term);
}

}  // namespace

EPI360_MULTIVERSION
GramSums gram_sums(const Matches& m) {
  Lanes lanes = {};
  Products p1, p2;
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    multiply_out(&m.x1[start], &m.y1[start], &m.z1[start], p1);
    multiply_out(&m.x2[start], &m.y2[start], &m.z2[start], p2);
    scale(&m.weight[start], p2);
    accumulate_products(p1, p2, lanes);
  }
  return sum_of(lanes);
}

EPI360_MULTIVERSION
GramSums gram_sums(const Matches& m, const double* N1, const double* N2) {
  Lanes lanes = {};
  Products p1, p2;
  double b[3][kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    transform(N1, &m.x1[start], &m.y1[start], &m.z1[start], b);
    multiply_out(b[0], b[1], b[2], p1);
    transform(N2, &m.x2[start], &m.y2[start], &m.z2[start], b);
    multiply_out(b[0], b[1], b[2], p2);
    scale(&m.weight[start], p2);
    accumulate_products(p1, p2, lanes);
  }
  return sum_of(lanes);
}

EPI360_MULTIVERSION
ViewMoments view_moments(const Matches& m, int view) {
  const double* b[3] = {view == 1 ? m.x1.data() : m.x2.data(),
                        view == 1 ? m.y1.data() : m.y2.data(),
                        view == 1 ? m.z1.data() : m.z2.data()};
  ViewMoments v = {};
  Products p;
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    const double* w = &m.weight[start];
    multiply_out(b[0] + start, b[1] + start, b[2] + start, p);
    v.weight += block_sum(w);
    for (int k = 0; k < 3; ++k) v.mean[k] += weighted_sum(b[k] + start, w);
    for (int k = 0; k < 6; ++k) v.second[k] += weighted_sum(p.product[k], w);
  }
  for (double& mean : v.mean) mean /= v.weight;
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    double squared[kBlock];
    for (std::size_t j = 0; j < kBlock; ++j) {
      const double dx = b[0][start + j] - v.mean[0], dy = b[1][start + j] - v.mean[1],
                   dz = b[2][start + j] - v.mean[2];
      squared[j] = dx * dx + dy * dy + dz * dz;
    }
    v.variance += weighted_sum(squared, &m.weight[start]);
  }
  v.variance /= v.weight;
  return v;
}

}  // namespace epi360
