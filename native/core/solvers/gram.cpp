// SPDX-License-Identifier: BSD-3-Clause
#include "core/solvers/gram.h"

#include <cmath>

#include "core/block_sum.h"
#include "core/multiversion.h"
#include "core/vector3.h"

namespace epi360 {
namespace {

constexpr std::size_t kBlock = Matches::kBlock;

struct Products {
  double product[6][kBlock];
};

template <typename Bearing>
EPI360_INLINE void multiply_out(std::size_t start, const Bearing& bearing, Products& p) {
  for (std::size_t j = 0; j < kBlock; ++j) {
    const Vec3 b = bearing(start + j);
    p.product[0][j] = b.x * b.x;
    p.product[1][j] = b.x * b.y;
    p.product[2][j] = b.x * b.z;
    p.product[3][j] = b.y * b.y;
    p.product[4][j] = b.y * b.z;
    p.product[5][j] = b.z * b.z;
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

template <typename First, typename Second>
EPI360_INLINE GramSums gram_loop(const Matches& m, const First& first, const Second& second) {
  Lanes lanes = {};
  Products p1, p2;
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    multiply_out(start, first, p1);
    multiply_out(start, second, p2);
    scale(&m.weight[start], p2);
    accumulate_products(p1, p2, lanes);
  }
  GramSums g;
  for (int k = 0; k < 36; ++k) g.sums[k] = lane_sum(lanes.entry[k]);
  return g;
}

EPI360_INLINE double weighted_sum(const double* x, const double* w) {
  double term[kBlock];
  for (std::size_t j = 0; j < kBlock; ++j) term[j] = w[j] * x[j];
  return block_sum(term);
}

}  // namespace

EPI360_MULTIVERSION
GramSums gram_sums(const Matches& m) {
  return gram_loop(
      m, [&](std::size_t i) EPI360_INLINE_LAMBDA { return bearing1(m, i); },
      [&](std::size_t i) EPI360_INLINE_LAMBDA { return bearing2(m, i); });
}

EPI360_MULTIVERSION
GramSums gram_sums(const Matches& m, const double* N1, const double* N2) {
  return gram_loop(
      m, [&](std::size_t i) EPI360_INLINE_LAMBDA { return product(N1, bearing1(m, i)); },
      [&](std::size_t i) EPI360_INLINE_LAMBDA { return product(N2, bearing2(m, i)); });
}

EPI360_MULTIVERSION
ViewMoments view_moments(const Matches& m, int view) {
  const double* b[3] = {view == 1 ? m.x1.data() : m.x2.data(),
                        view == 1 ? m.y1.data() : m.y2.data(),
                        view == 1 ? m.z1.data() : m.z2.data()};
  const auto bearing = [&](std::size_t i)
                           EPI360_INLINE_LAMBDA { return Vec3{b[0][i], b[1][i], b[2][i]}; };
  ViewMoments v = {};
  Products p;
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    const double* w = &m.weight[start];
    multiply_out(start, bearing, p);
    v.weight += block_sum(w);
    for (int k = 0; k < 3; ++k) v.mean[k] += weighted_sum(b[k] + start, w);
    for (int k = 0; k < 6; ++k) v.second[k] += weighted_sum(p.product[k], w);
  }
  for (double& mean : v.mean) mean /= v.weight;
  const Vec3 mean{v.mean[0], v.mean[1], v.mean[2]};
  v.variance = sum_of_terms(m.padded, [&](std::size_t i) EPI360_INLINE_LAMBDA {
    const Vec3 d = bearing(i) - mean;
    return m.weight[i] * dot(d, d);
  });
  v.variance /= v.weight;
  return v;
}

}  // namespace epi360
