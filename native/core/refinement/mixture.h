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

// residuals, margins (see residuals.h) and weights: m.padded entries. A match behind a camera by
// more than `tolerance` is no inlier whatever its residual; it may be a near miss, or else belongs
// to the uniform part.
MixtureSums mixture_pass(const Matches& m, const double* residuals, const double* margins,
                         double tolerance, bool may_be_near_miss, const LossModel& model,
                         double* weights);

// The same with densities relative to those of wrong matches, which differ from match to match:
// reach[i] is 1 over the density of match i (m.padded entries). log_likelihood is then the log-odds
// of the mixture over wrong matches alone.
MixtureSums mixture_pass_over_chance(const Matches& m, const double* residuals,
                                     const double* margins, double tolerance, const double* reach,
                                     const LossModel& model, double* weights);

// Weights and cost of the Geman-McClure loss, also as one pass.
double geman_mcclure_pass(const Matches& m, const double* residuals, const double* margins,
                          double tolerance, double scale, double* weights);

}  // namespace epi360
