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
// Share of a match's information that is noise, at which half of it counts.
constexpr double kHalfTrusted = 1.0 / 20.0;

}  // namespace

NoisyInformation noisy_information(const Matches& m, Residual residual,
                                   const RelativePose& cam2_from_cam1, const Linearisation& at,
                                   double variance) {
  const Eigen::Matrix<double, 3, 2, Eigen::RowMajor> basis = tangent_basis(cam2_from_cam1.t);
  const double per_residual = noise_per_residual(residual) * noise_per_residual(residual);
  std::vector<double> D(5 * kMoves * m.padded), there(m.padded), added(m.padded, 0.0);
  compute_second_derivatives(m, residual, plain(cam2_from_cam1), basis.data(), D.data(),
                             there.data());
  for (std::size_t k = 0; k < 5 * kMoves; ++k) {
    const double* row = D.data() + k * m.padded;
    for (std::size_t i = 0; i < m.padded; ++i) added[i] += row[i] * row[i];
  }
  std::vector<double> weights(m.padded, 0.0);
  double sum = 0.0, squares = 0.0;  // of what each match adds
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!(at.weights[i] > 0.0)) continue;
    const double share = per_residual * variance * added[i] / std::max(there[i], 1e-300);
    weights[i] = at.weights[i] / (1.0 + share / kHalfTrusted);
    sum += weights[i] * added[i];
    squares += std::pow(weights[i] * added[i], 2);
  }
  NoisyInformation information{Matrix5::Zero(), Matrix5::Zero(), 0.0};
  double upper[15], gradient[5];
  accumulate_normal_equations(m.padded, at.jacobian.data(), at.residuals.data(), weights.data(),
                              upper, gradient);
  information.total = symmetric(upper) / variance;
  for (std::size_t move = 0; move < kMoves; ++move) {
    accumulate_normal_equations(m.padded, D.data() + 5 * move * m.padded, at.residuals.data(),
                                weights.data(), upper, gradient);
    information.noise += per_residual * symmetric(upper);
  }
  if (sum > 0.0) information.deviation = std::sqrt(2.0 * squares) / sum;
  return information;
}

Matrix5 errors_in_variables(const NoisyInformation& information) {
  const Matrix5& noise = information.noise;
  const Matrix5 without =
      bounded_inverse(information.total - (1.0 + information.deviation) * noise);
  const Matrix5 covariance = without + without * noise * without;
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
