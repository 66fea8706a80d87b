// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/covariance.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/bearings.h"
#include "core/robust/derivative_noise.h"
#include "core/robust/evidence.h"
#include "core/robust/shared_error.h"

namespace epi360 {
namespace {

// Clustering above which a shared error is looked for: one in forty sets of independent errors.
constexpr double kSuspicious = 1.3;
// Share of the inliers that are left out as wrong ones at most: where more are expected, they are
// not all among those that tell most.
constexpr double kMostWrong = 0.05;

// Of so many inliers, after five parameters were fitted to them.
double degrees_of_freedom(double count) { return std::max(count - 5.0, 0.2 * count + 1e-9); }

// Standard deviation of the inliers' residuals, corrected for the part of a Gaussian that the gate
// cuts off.
double inlier_scale(const Matches& m, const std::vector<unsigned char>& inlier,
                    const std::vector<double>& residuals, double gate) {
  double sum = 0.0, count = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!inlier[i]) continue;
    sum += m.weight[i] * residuals[i] * residuals[i];
    count += m.weight[i];
  }
  // Variance of a unit Gaussian cut at +-k: 1 - 2 k phi(k) / (2 Phi(k) - 1); fixed point.
  const double observed = sum / degrees_of_freedom(count);
  double variance = observed;
  for (int round = 0; round < 20; ++round) {
    const double k = gate / std::sqrt(std::max(variance, 1e-30));
    const double inside = std::erf(k / std::sqrt(2.0));
    const double kept = 1.0 - 2.0 * k * kInverseRootTwoPi * std::exp(-0.5 * k * k) / inside;
    variance = observed / std::max(kept, 0.25);
  }
  return std::sqrt(variance);
}

// Leaves out so many matches, up to kMostWrong of them: those that would tell most about the pose.
void leave_out_most_telling(const Matches& m, long num, Linearisation& at) {
  if (num < 1) return;
  std::vector<std::size_t> rows;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (at.weights[i] > 0.0) rows.push_back(i);
  }
  num = std::min(num, std::lround(kMostWrong * static_cast<double>(rows.size())));
  if (num < 1) return;
  double upper[15], gradient[5];
  accumulate_normal_equations(m.padded, at.jacobian.data(), at.residuals.data(), at.weights.data(),
                              upper, gradient);
  const Matrix5 covariance = inverse(symmetric(upper));
  std::vector<double> told(m.size, 0.0);
  for (const std::size_t i : rows) {
    const Vector5 J = jacobian_of(at, m.padded, i);
    told[i] = at.weights[i] * J.dot(covariance * J);
  }
  std::nth_element(rows.begin(), rows.begin() + num, rows.end(), [&](std::size_t a, std::size_t b) {
    return told[a] > told[b] || (told[a] == told[b] && a < b);
  });
  for (long k = 0; k < num; ++k) at.weights[rows[static_cast<std::size_t>(k)]] = 0.0;
}

}  // namespace

Vector5 jacobian_of(const Linearisation& at, std::size_t padded, std::size_t i) {
  Vector5 J;
  for (std::size_t k = 0; k < 5; ++k) J[static_cast<Eigen::Index>(k)] = at.jacobian[k * padded + i];
  return J;
}

Uncertainty pose_uncertainty(const Matches& m, Residual residual,
                             const RelativePose& cam2_from_cam1, const LossModel& loss, double gate,
                             const std::vector<unsigned char>& inlier,
                             const std::vector<unsigned char>& dropped,
                             const std::vector<double>& residuals, const PosePrior& prior,
                             double least_shared_error, double num_wrong) {
  Uncertainty result;
  result.scale = inlier_scale(m, inlier, residuals, gate);
  const double variance = result.scale * result.scale;

  Linearisation at;
  at.resize(m.padded);
  const Eigen::Matrix<double, 3, 2, Eigen::RowMajor> basis = tangent_basis(cam2_from_cam1.t);
  compute_jacobians(m, residual, plain(cam2_from_cam1), basis.data(), at.residuals.data(),
                    at.margins.data(), at.jacobian.data());
  std::fill(at.weights.begin(), at.weights.end(), 0.0);
  double slope = 0.0, square = 0.0, count = 0.0;
  std::vector<double> trusts(m.size, 0.0);
  std::array<Vector5, kNumCells> sums;
  sums.fill(Vector5::Zero());
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!(at.margins[i] > -gate) || dropped[i]) continue;
    const double r = at.residuals[i];
    const LossSlopes psi = mixture_slopes(r, loss);
    slope += m.weight[i] * psi.second;
    square += m.weight[i] * m.weight[i] * psi.first * psi.first;
    const double trust = epipole_trust(cam2_from_cam1, view1(m, i), view2(m, i), variance);
    trusts[i] = trust * trust;
    if (inlier[i]) count += m.weight[i];
    const double score = m.weight[i] * trust * psi.first;
    at.weights[i] = score * score;
    sums[cell_of(view2(m, i))] += score * jacobian_of(at, m.padded, i);
  }
  double upper[15], gradient[5];
  accumulate_normal_equations(m.padded, at.jacobian.data(), at.residuals.data(), at.weights.data(),
                              upper, gradient);
  Matrix5 clustered = Matrix5::Zero();
  for (const Vector5& sum : sums) clustered += sum * sum.transpose();
  result.clustering = std::max(1.0, solve_symmetric(symmetric(upper), clustered).trace() / 5.0);

  for (std::size_t i = 0; i < m.size; ++i) at.weights[i] = inlier[i] * m.weight[i] * trusts[i];
  leave_out_most_telling(m, std::lround(num_wrong), at);
  const double freedom = count / degrees_of_freedom(count);
  const double efficiency = slope > 0.0 ? square * count / (slope * slope) : variance;
  const double inflated = std::max({efficiency * freedom, variance, m.least_scale * m.least_scale});
  Matrix5 errors =
      errors_in_variables(noisy_information(m, residual, cam2_from_cam1, at, inflated));
  if (least_shared_error > 0.0 || result.clustering > kSuspicious) {
    const SharedError shared =
        shared_error(m, cam2_from_cam1, at, std::sqrt(inflated), least_shared_error);
    errors += shared.covariance;
    result.shared = shared.variance / inflated;
  }
  Matrix5 information = inverse(errors);
  Vector5 slopes = Vector5::Zero();
  prior.accumulate(cam2_from_cam1, basis, 1.0, information, slopes);
  result.covariance = bounded_inverse(information);
  return result;
}

Uncertainty rotation_uncertainty(const Matches& m, const std::vector<unsigned char>& inlier,
                                 const std::vector<double>& residuals) {
  double sum = 0.0, count = 0.0;
  // Each match measures the two components of the rotation across its direction, with variance
  // 2 scale^2: information (I - b b^T) / (2 scale^2).
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!inlier[i]) continue;
    sum += m.weight[i] * residuals[i] * residuals[i];
    count += m.weight[i];
    const Eigen::Vector3d b = view2(m, i);
    information += m.weight[i] * (Eigen::Matrix3d::Identity() - b * b.transpose());
  }
  Uncertainty result;
  // Two components a match, three parameters.
  result.scale = std::sqrt(sum / std::max(2.0 * count - 3.0, 1.0));
  if (m.least_scale > kSmallestScale) result.scale = std::max(result.scale, m.least_scale);
  const double variance = 2.0 * std::max(result.scale * result.scale, 1e-24);
  result.covariance.setConstant(std::nan(""));
  // As for a pose: noisy copies of a point seem to lie apart, and what is free is known to 60
  // degrees.
  information = information / variance - count * Eigen::Matrix3d::Identity();
  Matrix5 padded = Matrix5::Identity();
  padded.topLeftCorner<3, 3>() = information;
  result.covariance.topLeftCorner<3, 3>() = bounded_inverse(padded).topLeftCorner<3, 3>();
  return result;
}

}  // namespace epi360
