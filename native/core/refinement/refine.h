// SPDX-License-Identifier: BSD-3-Clause
// Levenberg-Marquardt over SO(3) x S^2 with analytic Jacobians and a robust loss.
#pragma once

#include <vector>

#include "core/constants.h"
#include "core/matches.h"
#include "core/pose.h"
#include "core/refinement/loss.h"
#include "core/refinement/mixture.h"
#include "core/refinement/pose_prior.h"
#include "core/residuals/residuals.h"

namespace epi360 {

// Parallax of the wrong sign (radians) that noise of this scale explains; at most 4 degrees.
double depth_tolerance(double scale);

// Whether that is at its limit: the sign of a parallax then tells little of a match.
bool hides_depths(double scale);

PlainPose plain(const RelativePose& pose);

// A symmetric matrix of the 15 numbers of its upper triangle, by rows, as
// accumulate_normal_equations writes them.
inline Eigen::Matrix<double, 5, 5> symmetric(const double* upper) {
  Eigen::Matrix<double, 5, 5> matrix;
  for (int p = 0; p < 5; ++p) {
    for (int q = p; q < 5; ++q) matrix(p, q) = matrix(q, p) = *upper++;
  }
  return matrix;
}

// What a match is whose point lies behind a camera by more than noise explains: like any other; an
// outlier; or, under the mixture, a near miss or an outlier, but no inlier.
enum class Behind { kAsOthers, kOutlier, kNearMiss };

struct RefineOptions {
  Residual residual = Residual::kSampson;
  LossModel loss;
  PosePrior prior;
  Behind behind = Behind::kAsOthers;  // bounded losses only
  double smallest_scale = kSmallestScale;
  double largest_scale = 0.06;  // radians: with more noise than that nothing is an outlier
  int max_iterations = 100;
  double step_tolerance = 1e-10;  // radians
  // Of a mixture: the step's length in standard deviations of the pose at which to stop.
  double sigma_tolerance = 0.0;
};

struct RefineResult {
  RelativePose cam2_from_cam1;
  LossModel loss;  // with the estimated scale and shares of a mixture
  double cost = 0.0;
  int num_iterations = 0;
  bool converged = false;
  Eigen::Matrix<double, 5, 5> information = Eigen::Matrix<double, 5, 5>::Zero();  // J^T W J
  double effective_matches = 0.0;  // sum of the weights
  double weighted_squares = 0.0;   // of the residuals
};

// All matches at one pose: residuals, depths, derivatives, and their weights under a loss.
struct Linearisation {
  std::vector<double> residuals, margins, weights, jacobian;
  double tolerance = 0.0;  // parallax of the wrong sign that noise explains, radians
  double objective = 0.0;  // cost, or the negative log-likelihood of a mixture
  MixtureSums sums{};      // of a mixture
  void resize(std::size_t padded);
};

// Scratch memory of one refinement: reused between calls, one per thread. After it, `current` is
// the result's.
struct RefineWorkspace {
  Linearisation current, trial;
  void resize(std::size_t padded);
};

RefineResult refine(const Matches& m, const RelativePose& start, const RefineOptions& options,
                    RefineWorkspace& workspace);

// Fills in what refine leaves out: information, effective_matches, weighted_squares.
void set_statistics(const Matches& m, const RefineWorkspace& workspace, RefineResult& result);

}  // namespace epi360
