// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/derivative_noise.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "core/constants.h"
#include "core/residuals/second_derivatives.h"

namespace epi360 {
namespace {

constexpr double kFreeSigma = 60.0 * kDegree;  // of an angle of which nothing is known
constexpr std::size_t kMost = 512;             // matches that tell the noise: more are thinned out

// Some of the matches that have a weight, evenly over all; and how many times their weights all
// weigh.
struct Told {
  Matches matches;
  double times = 1.0;
};

Told thinned(const Matches& m, const std::vector<double>& weights) {
  std::vector<std::size_t> counted, chosen;
  double total = 0.0, kept = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!(weights[i] > 0.0)) continue;
    counted.push_back(i);
    total += weights[i];
  }
  const std::size_t step = std::max<std::size_t>(1, (counted.size() + kMost - 1) / kMost);
  for (std::size_t row = 0; row < counted.size(); row += step) chosen.push_back(counted[row]);
  Told told{chosen_matches(m, chosen)};
  for (std::size_t k = 0; k < chosen.size(); ++k) {
    told.matches.weight[k] = weights[chosen[k]];
    kept += weights[chosen[k]];
  }
  if (kept > 0.0) told.times = total / kept;
  return told;
}

}  // namespace

DerivativeNoise noise_of_derivatives(const Matches& m, Residual residual,
                                     const RelativePose& cam2_from_cam1,
                                     const std::vector<double>& weights, double variance) {
  const Eigen::Matrix<double, 3, 2, Eigen::RowMajor> basis = tangent_basis(cam2_from_cam1.t);
  const double per_residual = noise_per_residual(residual) * noise_per_residual(residual);
  Told told = thinned(m, weights);
  std::vector<double>& weight = told.matches.weight;
  const std::size_t padded = told.matches.padded;
  std::vector<double> D(5 * kMoves * padded), there(padded), added(padded, 1e-300);
  compute_second_derivatives(told.matches, residual, plain(cam2_from_cam1), basis.data(), D.data(),
                             there.data());
  for (std::size_t k = 0; k < 5 * kMoves; ++k) {
    for (std::size_t i = 0; i < padded; ++i) added[i] += D[k * padded + i] * D[k * padded + i];
  }
  DerivativeNoise noise{Matrix5::Zero(), 0.0};
  double sum = 0.0, squares = 0.0;  // of traces
  for (std::size_t i = 0; i < told.matches.size; ++i) {
    weight[i] *= std::min(there[i] / (per_residual * variance * added[i]), 1.0);
    const double trace = weight[i] * added[i];
    sum += trace;
    squares += trace * trace;
  }
  if (!(sum > 0.0)) return noise;
  for (std::size_t move = 0; move < kMoves; ++move) {
    double upper[15], gradient[5];
    accumulate_normal_equations(padded, D.data() + 5 * move * padded, there.data(), weight.data(),
                                upper, gradient);
    noise.information += symmetric(upper);
  }
  noise.information *= per_residual * told.times;
  noise.deviation = std::sqrt(2.0 * squares) / sum;
  return noise;
}

Matrix5 errors_in_variables(const Matrix5& information, const DerivativeNoise& noise) {
  const Matrix5 without =
      bounded_inverse(information - (1.0 + noise.deviation) * noise.information);
  const Matrix5 covariance = without + without * noise.information * without;
  if (!covariance.allFinite()) return without;
  const Matrix5 axes = symmetric_eigenvectors(covariance);
  Vector5 variances;
  for (int k = 0; k < 5; ++k) {
    variances[k] = std::min(axes.col(k).dot(covariance * axes.col(k)), kFreeSigma * kFreeSigma);
  }
  return axes * variances.asDiagonal() * axes.transpose();
}

Matrix5 bounded_inverse(const Matrix5& information) {
  constexpr double kFree = kFreeSigma * kFreeSigma;
  if (!information.allFinite()) return kFree * Matrix5::Identity();
  const Matrix5 axes = symmetric_eigenvectors(information);
  Vector5 variances;
  for (int k = 0; k < 5; ++k) {
    const double value = axes.col(k).dot(information * axes.col(k));
    variances[k] = value > 1.0 / kFree ? 1.0 / value : kFree;
  }
  return axes * variances.asDiagonal() * axes.transpose();
}

double noise_per_residual(Residual residual) {
  return residual == Residual::kPaper || residual == Residual::kAngular ? std::sqrt(0.5) : 1.0;
}

}  // namespace epi360
