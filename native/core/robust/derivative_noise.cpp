// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/derivative_noise.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "core/bearings.h"
#include "core/constants.h"

namespace epi360 {
namespace {

using Basis = Eigen::Matrix<double, 3, 2>;
using Derivatives = Eigen::Matrix<double, 5, 4>;

constexpr double kFreeSigma = 60.0 * kDegree;  // of an angle of which nothing is known
constexpr std::size_t kMost = 512;             // matches that tell the noise: more are thinned out
constexpr double kLeast = 1e-20;               // squared gradient of a residual, at an epipole

// How the bearings a = R b1 and b = b2 of a match move with what is noisy: its pixels where their
// Jacobians are known, else the axes of their tangent planes.
struct Moves {
  Basis a, b;
};

Moves moves_of(const Matches& m, Residual residual, const RelativePose& pose, std::size_t i) {
  if (residual != Residual::kTangentSampson) {
    return {tangent_basis(pose.R * view1(m, i)), tangent_basis(view2(m, i))};
  }
  Basis pixels1, pixels2;
  pixels1 << m.u1x[i], m.v1x[i], m.u1y[i], m.v1y[i], m.u1z[i], m.v1z[i];
  pixels2 << m.u2x[i], m.v2x[i], m.u2y[i], m.v2y[i], m.u2z[i], m.v2z[i];
  return {pose.R * pixels1, pixels2};
}

// Derivatives D of J, the derivative of a residual by the pose, by the four moves; and |J|^2. The
// residual is C / g with C = t . (a x b) and the gradient g of C by the moves (by those of b alone
// in one-sided residuals), so that dJ = dC' / g - C' dg / g^2 - dC g' / g^2, where the prime is the
// derivative by the pose. What C itself is a factor of is left out: C is small against g.
struct SecondDerivatives {
  Derivatives D;
  double squared_jacobian;
};

SecondDerivatives second_derivatives(const RelativePose& pose, const Basis& basis,
                                     const Eigen::Vector3d& b1, const Eigen::Vector3d& b,
                                     const Moves& moves, bool is_one_sided) {
  const Eigen::Vector3d& t = pose.t;
  const Eigen::Vector3d a = pose.R * b1, bt = b.cross(t), ta = t.cross(a);
  const auto by_pose = [&](const Eigen::Vector3d& by_w, const Eigen::Vector3d& by_t) {
    Vector5 both;
    both << by_w, basis.transpose() * by_t;
    return both;
  };
  const Vector5 C_by_pose = by_pose(a.cross(bt), a.cross(b));
  const Eigen::Vector2d C_by_a = moves.a.transpose() * bt, C_by_b = moves.b.transpose() * ta;
  const double part = is_one_sided ? 0.0 : 1.0;  // of the moves of a
  const double squared = std::max(part * C_by_a.squaredNorm() + C_by_b.squaredNorm(), kLeast);
  const Eigen::Vector3d of_a = part * moves.a * C_by_a, of_b = moves.b * C_by_b;
  // g g' / g^2, and g dg / g^2 by each move.
  const Vector5 g_by_pose =
      by_pose(of_a.cross(bt) + a.cross(of_b.cross(t)), of_a.cross(b) + a.cross(of_b)) / squared;
  SecondDerivatives result;
  for (int k = 0; k < 2; ++k) {
    const Eigen::Vector3d da = moves.a.col(k), db = moves.b.col(k), dbt = db.cross(t);
    result.D.col(k) = by_pose(da.cross(bt), da.cross(b)) -
                      of_b.dot(t.cross(da)) / squared * C_by_pose - C_by_a[k] * g_by_pose;
    result.D.col(2 + k) = by_pose(a.cross(dbt), a.cross(db)) - of_a.dot(dbt) / squared * C_by_pose -
                          C_by_b[k] * g_by_pose;
  }
  result.D /= std::sqrt(squared);
  result.squared_jacobian = C_by_pose.squaredNorm() / squared;
  return result;
}

}  // namespace

DerivativeNoise noise_of_derivatives(const Matches& m, Residual residual,
                                     const RelativePose& cam2_from_cam1,
                                     const std::vector<double>& weights, double variance) {
  const Basis basis = tangent_basis(cam2_from_cam1.t);
  const bool is_one_sided = residual == Residual::kPaper || residual == Residual::kAngular;
  const double per_residual = noise_per_residual(residual) * noise_per_residual(residual);
  std::vector<std::size_t> counted;
  double total = 0.0, told = 0.0;  // weights of all, and of those that are looked at
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!(weights[i] > 0.0)) continue;
    counted.push_back(i);
    total += weights[i];
  }
  const std::size_t step = std::max<std::size_t>(1, (counted.size() + kMost - 1) / kMost);
  DerivativeNoise noise{Matrix5::Zero(), 0.0};
  double sum = 0.0, squares = 0.0;  // of traces
  for (std::size_t row = 0; row < counted.size(); row += step) {
    const std::size_t i = counted[row];
    const SecondDerivatives at =
        second_derivatives(cam2_from_cam1, basis, view1(m, i), view2(m, i),
                           moves_of(m, residual, cam2_from_cam1, i), is_one_sided);
    const double added = per_residual * at.D.squaredNorm(), there = at.squared_jacobian / variance;
    const double weight = weights[i] * (added > there ? there / added : 1.0);
    noise.information.noalias() += weight * per_residual * (at.D * at.D.transpose());
    told += weights[i];
    sum += weight * added;
    squares += std::pow(weight * added, 2);
  }
  if (!(sum > 0.0)) return noise;
  noise.information *= total / told;
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
