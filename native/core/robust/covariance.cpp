// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/covariance.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/bearings.h"
#include "core/robust/evidence.h"
#include "core/robust/shared_error.h"

namespace epi360 {
namespace {

// Clustering above which a shared error is looked for; independent errors give 1.1 at most.
constexpr double kSuspicious = 1.15;
constexpr double kFreeSigma = 60.0 * kDegree;  // of an angle of which nothing is known

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

// What the noise of the bearings alone adds to J^T W J / variance: noisy copies of one point seem
// to lie in different directions, and matches without parallax seem to have some. The derivatives
// by the rotation have up to half the variance of the noise, those by the translation that of the
// parallax, 2 (I - b b^T) / |g|^2 with the gradient g of the residual; neither more than is there.
Matrix5 noise_in_information(const Matches& m, const RelativePose& cam2_from_cam1,
                             const Linearisation& at, double variance) {
  const Eigen::Matrix<double, 3, 2> basis = tangent_basis(cam2_from_cam1.t);
  Matrix5 noise = Matrix5::Zero();
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!(at.weights[i] > 0.0)) continue;
    const Vector5 J = jacobian_of(at, m.padded, i);
    const Eigen::Vector3d b = view2(m, i);
    const double gradient = 2.0 * std::max(b.cross(cam2_from_cam1.t).squaredNorm(), 1e-12);
    const Eigen::Vector2d along = basis.transpose() * b;
    const Eigen::Matrix2d parallax =
        2.0 / gradient * (Eigen::Matrix2d::Identity() - along * along.transpose());
    const double there = J.tail<2>().squaredNorm() / variance;
    const double most = J.head<3>().squaredNorm() / (3.0 * variance);
    noise.topLeftCorner<3, 3>().diagonal().array() += at.weights[i] * std::min(0.5, most);
    noise.bottomRightCorner<2, 2>() +=
        at.weights[i] * std::min(1.0, there / parallax.trace()) * parallax;
  }
  return noise;
}

// Covariance A^-1 + A^-1 N A^-1 of what J^T W J / variance = A + N determines, where N is the noise
// of the derivatives: errors in variables (Fuller 1987, section 2.2). The second term counts where
// the parallax is not large against the noise.
Matrix5 errors_in_variables(const Matrix5& information, const Matrix5& noise) {
  const Matrix5 without = bounded_inverse(information - noise);
  const Matrix5 covariance = without + without * noise * without;
  if (!covariance.allFinite()) return without;
  const Matrix5 axes = symmetric_eigenvectors(covariance);
  Vector5 variances;
  for (int k = 0; k < 5; ++k) {
    variances[k] = std::min(axes.col(k).dot(covariance * axes.col(k)), kFreeSigma * kFreeSigma);
  }
  return axes * variances.asDiagonal() * axes.transpose();
}

}  // namespace

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
                             double shared_error) {
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
  accumulate_normal_equations(m.padded, at.jacobian.data(), at.residuals.data(), at.weights.data(),
                              upper, gradient);
  const double freedom = count / degrees_of_freedom(count);
  const double efficiency = slope > 0.0 ? square * count / (slope * slope) : variance;
  const double inflated =
      std::max({efficiency * freedom, variance, kSmallestScale * kSmallestScale});
  Matrix5 errors = errors_in_variables(symmetric(upper) / inflated,
                                       noise_in_information(m, cam2_from_cam1, at, inflated));
  if (shared_error > 0.0 || result.clustering > kSuspicious) {
    errors += shared_error_covariance(m, cam2_from_cam1, at, std::sqrt(inflated), shared_error);
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
