// SPDX-License-Identifier: BSD-3-Clause
// What a small residual is worth, by how far the partner lies from where a rotation takes a match.
//
// Wrong matches are seldom partners from anywhere. One tile is taken for the next, a tram drives
// on, somebody walks ahead of the camera: their partners lie a few degrees off, and agree to that
// with every pose whose rotation is about right. If wrong residuals had one density for all
// matches, a pose with so much noise, which explains them and the right ones too, would be the most
// likely. But let chance draw the direction of a displacement, its length given: then a residual of
// half a degree says nothing where the partner lies one degree off, and much where it lies thirty.
#pragma once

#include <vector>

#include "core/matches.h"
#include "core/refinement/loss.h"

namespace epi360 {

// Sines of the displacements of all matches, padding included: of the angle between R b1 and b2
// under the rotation R that most matches are near, or between b1 and b2 if that is less, as for
// what the camera carries. They are of the pair, so that no pose is preferred for its parallax.
std::vector<double> displacements(const Matches& m);

// Log-odds of all matches under the mixture at a pose, over wrong matches alone. The residual of a
// partner that is displaced by the angle l in a random direction has the density 1 / (sqrt(2) pi
// sin l) per radian near zero and in front of both cameras; on average over the sphere that is
// kTypicalDensity. The shares of the mixture are those that make the odds largest, by expectation
// maximisation. displaced: the sines. residuals, margins, depth_tolerance: as of mixture_pass.
double log_odds_over_chance(const Matches& m, const std::vector<double>& displaced,
                            const double* residuals, const double* margins, double depth_tolerance,
                            const LossModel& mixture);

}  // namespace epi360
