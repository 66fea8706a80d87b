// SPDX-License-Identifier: BSD-3-Clause
// Passes over all residuals under the mixture of loss.h, vectorised: exp and log of the library
// cost more than everything else in a refinement together (measured: 4 times the whole pass).
#pragma once

#include <cstddef>

#include "loss.h"

namespace epi360 {

// Inputs of a pass. A match with front 0 belongs to the uniform part whatever its residual.
struct MixturePass {
  std::size_t padded;
  const double* residuals;
  const double* front;
  const double* weight;  // the user's, 0 for padding
};

// Sums of one expectation step.
struct MixtureSums {
  double part[LossModel::kGaussians];  // matches in each Gaussian
  double squares;                      // of the residuals, by precision
  double count;
};
MixtureSums mixture_expectation(const MixturePass& pass, const LossModel& model);

// Weight of every match in the pose; returns their sum.
double mixture_weights(const MixturePass& pass, const LossModel& model, double* weights);

// Sum of weight * log density.
double mixture_log_likelihood(const MixturePass& pass, const LossModel& model);

}  // namespace epi360
