// SPDX-License-Identifier: BSD-3-Clause
// Passes over all residuals under the mixture of loss.h, vectorised: exp and log of the library
// cost more than everything else in a refinement together (measured: 4 times the whole pass).
#pragma once

#include <cstddef>

#include "core/refinement/loss.h"

namespace epi360 {

// Inputs of a pass. A match with in_front 0 belongs to the uniform part whatever its residual.
struct MixturePass {
  std::size_t padded;
  const double* residuals;
  const double* in_front;
  const double* weight;  // the user's, 0 for padding
  bool unit_weights;     // all of them are 1: the logarithm of a product serves four matches
};

// One look at all matches: the expectation step, the weights of the next pose step, the likelihood.
struct MixtureSums {
  double part[LossModel::kGaussians];  // matches in each Gaussian
  double squares;                      // of the residuals, by precision
  double count;                        // of the matches
  double log_likelihood;
};
MixtureSums mixture_pass(const MixturePass& pass, const LossModel& model, double* weights);

// Weights and cost of the Geman-McClure loss, also as one pass.
double geman_mcclure_pass(const MixturePass& pass, double scale, double* weights);

}  // namespace epi360
