// SPDX-License-Identifier: BSD-3-Clause
// Robust losses of a squared residual s with scale c: cost rho(s) and weight rho'(s).
#pragma once

#include <algorithm>
#include <cmath>

#include "core/constants.h"

namespace epi360 {

enum class Loss { kSquared, kHuber, kCauchy, kGemanMcClure, kMixture };

// Parameters of a loss. The mixture is a Gaussian of standard deviation `scale` (the inliers),
// wider ones of 4, 16 and 64 times that (the near misses of real matches, at whatever scale they
// come: one fixed outlier density lets the inliers' Gaussian swell until it swallows them, and the
// pose follows), and a constant density of outliers per radian of signed residual.
struct LossModel {
  static constexpr int kGaussians = 4;

  Loss loss = Loss::kSquared;
  double scale = 1.0;
  double share[kGaussians] = {0.4, 0.1, 0.1, 0.1};
  double outlier_density = kTypicalDensity;

  double uniform_share() const { return 1.0 - share[0] - share[1] - share[2] - share[3]; }
};

struct LossValue {
  double cost, weight;
};

// Densities of the parts at squared residual s, times their shares.
struct MixtureParts {
  double gaussian[LossModel::kGaussians], uniform;
  double total() const { return gaussian[0] + gaussian[1] + gaussian[2] + gaussian[3] + uniform; }
};

inline MixtureParts mixture_parts(double s, const LossModel& m) {
  const double peak = kInverseRootTwoPi / m.scale;
  // exp(-z / 16^k) for k = 3, 2, 1, 0: each the sixteenth power of the one before.
  double e = std::exp(-0.5 * s / (m.scale * m.scale * 4096.0));
  MixtureParts p;
  double height = peak / 64.0;
  for (int k = LossModel::kGaussians - 1; k >= 0; --k) {
    p.gaussian[k] = m.share[k] * height * e;
    for (int squaring = 0; squaring < 4; ++squaring) e *= e;
    height *= 4.0;
  }
  p.uniform = m.uniform_share() * m.outlier_density;
  return p;
}

// First and second derivative of the negative log-likelihood of the mixture at residual r.
struct LossSlopes {
  double first, second;
};

inline LossSlopes mixture_slopes(double r, const LossModel& m) {
  const MixtureParts p = mixture_parts(r * r, m);
  const double total = p.total();
  double precision = 1.0 / (m.scale * m.scale), mean = 0.0, squares = 0.0;
  for (int k = 0; k < LossModel::kGaussians; ++k) {
    const double share = p.gaussian[k] / total;
    mean += share * precision;
    squares += share * precision * precision;
    precision /= 16.0;
  }
  return {r * mean, mean - r * r * (squares - mean * mean)};
}

// Of the losses that need no pass over all residuals at once (mixture.h).
inline LossValue evaluate_loss(double s, const LossModel& m) {
  const double c2 = m.scale * m.scale;
  if (m.loss == Loss::kCauchy) return {c2 * std::log1p(s / c2), 1.0 / (1.0 + s / c2)};
  if (m.loss == Loss::kSquared || s <= c2) return {s, 1.0};
  const double r = std::sqrt(s);
  return {2.0 * m.scale * r - c2, m.scale / r};
}

}  // namespace epi360
