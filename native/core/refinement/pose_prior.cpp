// SPDX-License-Identifier: BSD-3-Clause
#include "core/refinement/pose_prior.h"

#include <Eigen/Geometry>

namespace epi360 {
namespace {

// Both views err: the variance of an axis of R g1 - g2.
double tilt_variance(const PosePrior& prior) {
  return 2.0 * prior.gravity_sigma * prior.gravity_sigma;
}

}  // namespace

double PosePrior::cost(const RelativePose& pose) const {
  if (!has_gravity) return 0.0;
  double cost = 0.5 * (pose.R * gravity1 - gravity2).squaredNorm() / tilt_variance(*this);
  if (elevation_sigma > 0.0) {
    const double elevation = pose.t.dot(gravity2) / elevation_sigma;
    cost += 0.5 * elevation * elevation;
  }
  return cost;
}

void PosePrior::accumulate(const RelativePose& pose, const Eigen::Matrix<double, 3, 2>& basis,
                           double factor, Eigen::Matrix<double, 5, 5>& hessian,
                           Eigen::Matrix<double, 5, 1>& gradient) const {
  if (!has_gravity) return;
  const Eigen::Vector3d turned = pose.R * gravity1;
  const Eigen::Matrix3d J = -skew(turned);  // of w x (R g1)
  const double weight = factor / tilt_variance(*this);
  hessian.topLeftCorner<3, 3>() += weight * J.transpose() * J;
  gradient.head<3>() += weight * J.transpose() * (turned - gravity2);
  if (!(elevation_sigma > 0.0)) return;
  const Eigen::Vector2d slope = basis.transpose() * gravity2;
  const double precision = factor / (elevation_sigma * elevation_sigma);
  hessian.bottomRightCorner<2, 2>() += precision * slope * slope.transpose();
  gradient.tail<2>() += precision * pose.t.dot(gravity2) * slope;
}

}  // namespace epi360
