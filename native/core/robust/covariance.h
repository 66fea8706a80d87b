// SPDX-License-Identifier: BSD-3-Clause
// Scale of the noise and covariance of a pose, from its inliers.
#pragma once

#include <cmath>
#include <vector>

#include "core/matches.h"
#include "core/refinement/refine.h"
#include "core/residuals/residuals.h"
#include "core/solvers/dense.h"

namespace epi360 {

struct Uncertainty {
  double scale;                            // standard deviation of the inliers' residuals, radians
  Eigen::Matrix<double, 5, 5> covariance;  // NaN where the matches tell nothing
  double clustering =
      1.0;              // how much more the sums over cells vary than independent errors let them
  double shared = 0.0;  // variance of the error that neighbours share, over that of one match
};

// Standard deviations of rotation and direction, over all their components.
inline double rotation_sigma(const Eigen::Matrix<double, 5, 5>& covariance) {
  return std::sqrt(covariance.topLeftCorner<3, 3>().trace());
}
inline double direction_sigma(const Eigen::Matrix<double, 5, 5>& covariance) {
  return std::sqrt(covariance.bottomRightCorner<2, 2>().trace());
}

// How far the first-order residual of a match can be trusted, in [0, 1]: near an epipole it
// promises more than a bearing with noise of this variance can hold.
inline double epipole_trust(const RelativePose& cam2_from_cam1, const Eigen::Vector3d& b1,
                            const Eigen::Vector3d& b2, double variance) {
  const Eigen::Vector3d& t = cam2_from_cam1.t;
  const double squared = (cam2_from_cam1.R * b1).cross(t).squaredNorm() + b2.cross(t).squaredNorm();
  return squared / (squared + 8.0 * variance);
}

// Derivative of one residual by the five parameters of the pose.
Eigen::Matrix<double, 5, 1> jacobian_of(const Linearisation& at, std::size_t padded, std::size_t i);

// Covariance of an M-estimator (Huber 1981): (mean psi^2 / (mean psi')^2) (J^T J)^-1, with the
// derivative psi of the negative log-likelihood, so that the wrong matches which agree by chance
// count as the noise they are. What the errors of neighbouring matches share is added, at least
// least_shared_error standard deviations of one match: see shared_error.h.
// residuals: those that the inliers were marked by; dropped: matches that leverage left out;
// num_wrong: how many inliers are expected to be wrong matches. Of a pose with little parallax such
// matches have much more of it than the right ones, and seem to tell most: so many of those that
// tell most do not count.
Uncertainty pose_uncertainty(const Matches& m, Residual residual,
                             const RelativePose& cam2_from_cam1, const LossModel& loss, double gate,
                             const std::vector<unsigned char>& inlier,
                             const std::vector<unsigned char>& dropped,
                             const std::vector<double>& residuals, const PosePrior& prior,
                             double least_shared_error, double num_wrong);

// The same of a rotation alone, NaN where the translation would be.
Uncertainty rotation_uncertainty(const Matches& m, const std::vector<unsigned char>& inlier,
                                 const std::vector<double>& residuals);

}  // namespace epi360
