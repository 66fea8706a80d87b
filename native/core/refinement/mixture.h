// SPDX-License-Identifier: BSD-3-Clause
// Passes over all residuals under the mixture of loss.h, vectorised: exp and log of the library
// cost more than everything else in a refinement together (measured: 4 times the whole pass).
#pragma once

#include "core/matches.h"
#include "core/refinement/loss.h"

namespace epi360 {

// One look at all matches: the expectation step, the weights of the next pose step, the likelihood.
struct MixtureSums {
  double part[LossModel::kGaussians];  // matches in each Gaussian
  double squares;                      // of the residuals, by precision
  double count;                        // of the matches
  double log_likelihood;
};

// residuals, in_front and weights: m.padded entries. A match with in_front 0 belongs to the uniform
// part whatever its residual.
MixtureSums mixture_pass(const Matches& m, const double* residuals, const double* in_front,
                         const LossModel& model, double* weights);

// Weights and cost of the Geman-McClure loss, also as one pass.
double geman_mcclure_pass(const Matches& m, const double* residuals, const double* in_front,
                          double scale, double* weights);

}  // namespace epi360
