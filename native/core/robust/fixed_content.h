// SPDX-License-Identifier: BSD-3-Clause
// What is fixed to the camera: a tripod, a car, an operator with a stick, a logo, a black cap.
//
// It stands still in the image while the camera moves, and matches itself as a camera that never
// moved would. Where such matches outnumber those of the scene, they are the answer unless somebody
// asks what the others say.
#pragma once

#include <cstddef>
#include <vector>

#include "core/matches.h"
#include "core/residuals/residuals.h"
#include "core/robust/estimate.h"
#include "core/robust/matches_left.h"

namespace epi360 {

// Matches that both views see in the same direction, to the tolerance of stitched or bent content.
std::vector<std::size_t> standing_still(const Matches& m, double gate);

// Matches that an answer without a pose rests on, if most of its inliers stand still, or that may
// be one of two poses: they may be fixed to the camera. None where the others are not worth asking.
std::vector<std::size_t> maybe_fixed(const Matches& m, const RobustResult& answer);

// What the answer of the others says, if it is a pose or a rotation that many of the others agree
// with (the first answer tells how many), and under which most of those would have moved: that
// those are fixed, because its inliers surround the camera more than they do; or a pose, and
// nothing tells which of both has moved.
enum class OthersSay { kNothing, kPose, kFixed };
OthersSay others_say(const Matches& m, const std::vector<std::size_t>& fixed,
                     const MatchesLeft& left, const RobustResult& first, const RobustResult& answer,
                     Residual residual);

}  // namespace epi360
