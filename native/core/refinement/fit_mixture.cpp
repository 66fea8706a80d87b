// SPDX-License-Identifier: BSD-3-Clause
#include "core/refinement/fit_mixture.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace epi360 {
namespace {

// Moves shares to the inliers until part k has at most `ratio` times theirs.
void limit_share(LossModel& loss, int k, double ratio) {
  const double both = loss.share[0] + loss.share[k];
  if (loss.share[k] <= ratio * loss.share[0]) return;
  loss.share[0] = both / (1.0 + ratio);
  loss.share[k] = both - loss.share[0];
}

constexpr int kBins = 40;         // of |residual|, logarithmic
constexpr int kScales = 12;       // candidate standard deviations
constexpr int kStepsPerPart = 2;  // scale_of(k + 2) = 4 scale_of(k)
constexpr int kRows = kScales + kStepsPerPart * (LossModel::kGaussians - 1);
constexpr double kFirstBin = 1e-6;  // radians
constexpr double kBinsPerOctave = 1.8;

double bin_edge(int k) { return kFirstBin * std::exp2(k / kBinsPerOctave); }
double scale_of(int k) { return 4e-5 * std::exp2(k); }  // 0.002 to 6 degrees

// Probability that |residual| of a Gaussian falls into each bin, and each bin's width.
struct BinTable {
  std::array<std::array<double, kBins>, kRows> mass;
  std::array<double, kBins> width;
  BinTable() {
    for (int b = 0; b < kBins; ++b) {
      const double low = b == 0 ? 0.0 : bin_edge(b), high = bin_edge(b + 1);
      width[b] = high - low;
      for (int k = 0; k < kRows; ++k) {
        const double root = 1.0 / (scale_of(k) * std::sqrt(2.0));
        mass[k][b] = std::erf(high * root) - std::erf(low * root);
      }
    }
  }
};

}  // namespace

void set_shares(const double* in_part, double count, LossModel& loss) {
  for (int k = 0; k < LossModel::kGaussians; ++k) loss.share[k] = in_part[k] / count;
  loss.share[0] = std::max(loss.share[0], 1e-3);
  limit_share(loss, 1, 0.5);
  limit_share(loss, 2, 1.0);
  const double sum = 1.0 - loss.uniform_share();
  if (sum > 0.999) {
    for (double& share : loss.share) share *= 0.999 / sum;
  }
}

double scale_evidence(const LossModel& mixture) { return 5.0 * std::log(mixture.scale); }

LossModel fit_mixture(const Matches& m, const double* residuals, const double* margins,
                      double tolerance, double outlier_density, double smallest_scale) {
  static const BinTable table;
  std::array<double, kBins> counts{};
  double total = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    total += m.weight[i];
    if (!(margins[i] > -tolerance) || !std::isfinite(residuals[i])) continue;
    const double octave = std::log2(std::abs(residuals[i]) / kFirstBin + 1e-30);
    const int b = static_cast<int>(kBinsPerOctave * octave);
    if (b < kBins) counts[std::max(b, 0)] += m.weight[i];
  }
  LossModel best;
  double best_likelihood = -1e300;
  for (int k = 0; k < kScales; ++k) {
    if (scale_of(k) < smallest_scale) continue;
    LossModel model;
    model.loss = Loss::kMixture;
    model.outlier_density = outlier_density;
    model.scale = scale_of(k);
    double likelihood = 0.0;
    for (int round = 0; round < 4; ++round) {
      double in_part[LossModel::kGaussians] = {0.0};
      likelihood = 0.0;
      const bool last = round == 3;
      const double uniform = model.uniform_share() * 2.0 * outlier_density;
      for (int b = 0; b < kBins; ++b) {
        if (counts[b] == 0.0) continue;
        double part[LossModel::kGaussians], all = uniform * table.width[b];
        for (int j = 0; j < LossModel::kGaussians; ++j) {
          part[j] = model.share[j] * table.mass[k + kStepsPerPart * j][b];
          all += part[j];
        }
        for (int j = 0; j < LossModel::kGaussians; ++j) in_part[j] += counts[b] * part[j] / all;
        if (last) likelihood += counts[b] * std::log(all);
      }
      set_shares(in_part, total, model);
    }
    likelihood += scale_evidence(model);
    if (likelihood > best_likelihood) {
      best_likelihood = likelihood;
      best = model;
    }
  }
  return best;
}

}  // namespace epi360
