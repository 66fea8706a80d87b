// SPDX-License-Identifier: BSD-3-Clause
#include "core/refinement/mixture.h"

#include <algorithm>

#include "core/block_sum.h"
#include "core/constants.h"
#include "core/multiversion.h"
#include "core/vector_exp.h"

namespace epi360 {
namespace {

constexpr std::size_t kBlock = Matches::kBlock;

// As mixture_parts of loss.h, with the constants of the model at hand.
struct Model {
  double factor;  // -1 / (2 * 4096 * scale^2)
  double height[LossModel::kGaussians];
  double uniform;
};

EPI360_INLINE Model prepared(const LossModel& m, double outlier_density) {
  Model out;
  out.factor = -0.5 / (m.scale * m.scale * 4096.0);
  double height = kInverseRootTwoPi / m.scale;
  for (int k = 0; k < LossModel::kGaussians; ++k) {
    out.height[k] = m.share[k] * height;
    height *= 0.25;
  }
  out.uniform = m.uniform_share() * outlier_density;
  return out;
}

// near_miss: share of the wider Gaussians that is left to a match behind a camera, 0 or 1. reach:
// what the Gaussians' densities are multiplied by.
EPI360_INLINE MixtureParts parts_at(double residual, bool in_front, double near_miss, double reach,
                                    const Model& m) {
  MixtureParts p;
  double e = vector_exp(residual * residual * m.factor) * (in_front ? 1.0 : near_miss);
  for (int k = LossModel::kGaussians - 1; k >= 0; --k) {
    p.gaussian[k] = m.height[k] * e * reach;
    for (int squaring = 0; squaring < 4; ++squaring) e *= e;
  }
  p.gaussian[0] = in_front ? p.gaussian[0] : 0.0;
  p.uniform = m.uniform;
  return p;
}

EPI360_INLINE double precision_of(const double* g) {
  return g[0] + g[1] / 16.0 + g[2] / 256.0 + g[3] / 4096.0;
}

// Sums of all matches in eight lanes: see accumulate_normal_equations.
struct LaneSum {
  double lane[kLanes] = {};
};

EPI360_INLINE double total_of(const LaneSum& s) { return lane_sum(s.lane); }

template <bool unit, bool over_chance>
EPI360_INLINE MixtureSums pass_loop(const Matches& m, const double* residuals,
                                    const double* margins, double tolerance, double near_miss,
                                    const double* reach, const LossModel& loss, double* weights) {
  const Model model = prepared(loss, over_chance ? 1.0 : loss.outlier_density);
  LaneSum part[LossModel::kGaussians], squares, count, log_density;
  double weight[kBlock], total[kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t group = 0; group < kBlock; group += kLanes) {
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        const std::size_t j = group + lane, i = start + j;
        const double r = residuals[i], own = m.weight[i];
        const MixtureParts p =
            parts_at(r, margins[i] > -tolerance, near_miss, over_chance ? reach[i] : 1.0, model);
        const double all = p.total(), share = own / all;
        for (int k = 0; k < LossModel::kGaussians; ++k) part[k].lane[lane] += share * p.gaussian[k];
        weight[j] = share * precision_of(p.gaussian);
        squares.lane[lane] += weight[j] * r * r;
        count.lane[lane] += own;
        total[j] = unit && own == 0.0 ? 1.0 : all;
      }
    }
    std::copy(weight, weight + kBlock, weights + start);
    if (unit) {  // densities are between 1e-4 and 1e6: products of four stay in range
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        log_density.lane[lane] += vector_log(total[lane] * total[lane + kLanes] *
                                             total[lane + 2 * kLanes] * total[lane + 3 * kLanes]);
      }
    } else {
      for (std::size_t group = 0; group < kBlock; group += kLanes) {
        for (std::size_t lane = 0; lane < kLanes; ++lane) {
          log_density.lane[lane] +=
              m.weight[start + group + lane] * vector_log(total[group + lane]);
        }
      }
    }
  }
  MixtureSums sums = {{}, total_of(squares), total_of(count), total_of(log_density)};
  for (int k = 0; k < LossModel::kGaussians; ++k) sums.part[k] = total_of(part[k]);
  return sums;
}

}  // namespace

EPI360_MULTIVERSION_WIDE
MixtureSums mixture_pass(const Matches& m, const double* residuals, const double* margins,
                         double tolerance, bool may_be_near_miss, const LossModel& model,
                         double* weights) {
  const double near_miss = may_be_near_miss ? 1.0 : 0.0;
  return m.unit_weights ? pass_loop<true, false>(m, residuals, margins, tolerance, near_miss,
                                                 nullptr, model, weights)
                        : pass_loop<false, false>(m, residuals, margins, tolerance, near_miss,
                                                  nullptr, model, weights);
}

EPI360_MULTIVERSION_WIDE
MixtureSums mixture_pass_over_chance(const Matches& m, const double* residuals,
                                     const double* margins, double tolerance, const double* reach,
                                     const LossModel& model, double* weights) {
  return m.unit_weights
             ? pass_loop<true, true>(m, residuals, margins, tolerance, 0.0, reach, model, weights)
             : pass_loop<false, true>(m, residuals, margins, tolerance, 0.0, reach, model, weights);
}

EPI360_MULTIVERSION_WIDE
double geman_mcclure_pass(const Matches& m, const double* residuals, const double* margins,
                          double tolerance, double scale, double* weights) {
  const double squared_scale = scale * scale, inverse = 1.0 / squared_scale;
  LaneSum cost;
  for (std::size_t start = 0; start < m.padded; start += kLanes) {
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const std::size_t i = start + lane;
      const double s = residuals[i] * residuals[i], own = m.weight[i];
      const double front = margins[i] > -tolerance ? 1.0 : 0.0;
      const double d = 1.0 / (1.0 + s * inverse);
      weights[i] = own * d * d * front;
      cost.lane[lane] += own * (s * d * front + squared_scale * (1.0 - front));
    }
  }
  return total_of(cost);
}

}  // namespace epi360
