// SPDX-License-Identifier: BSD-3-Clause
// Where the mixture of loss.h starts, and what keeps it from swallowing everything.
#pragma once

#include "core/matches.h"
#include "core/refinement/loss.h"

namespace epi360 {

// Shares of the parts. The inliers are the main body, not its sharp tip: their tail (4 scales) may
// hold half as many matches, the near misses behind it (16 scales) as many as they do.
void set_shares(const double* in_part, double count, LossModel& loss);

// Five matches can always be fitted perfectly. Added to the log-likelihood, this is the part of the
// pose's Laplace evidence that depends on the scale: it takes back what five residuals near zero
// gain.
double scale_evidence(const LossModel& mixture);

// Scale and shares of the mixture that make these residuals most likely, from a grid of scales:
// where the iteration starts. residuals and margins have m.padded entries; a match behind a camera
// by more than `tolerance` belongs to the uniform part.
LossModel fit_mixture(const Matches& m, const double* residuals, const double* margins,
                      double tolerance, double outlier_density, double smallest_scale);

}  // namespace epi360
