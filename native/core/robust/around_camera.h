// SPDX-License-Identifier: BSD-3-Clause
// Whether matches lie around the camera: what passes by, clouds and water lie on one side.
#pragma once

#include <cstddef>
#include <vector>

#include "core/matches.h"

namespace epi360 {

// Whether the chosen matches lie around the camera in both views, in no hemisphere.
bool are_all_around(const Matches& m, const std::vector<std::size_t>& chosen);

// The same, and near to no plane through the camera, as what is seen at the horizon is.
bool surround(const Matches& m, const std::vector<std::size_t>& chosen);

}  // namespace epi360
