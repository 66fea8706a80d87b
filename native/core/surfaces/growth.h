// SPDX-License-Identifier: BSD-3-Clause
// Surfaces that two panoramas of known pose share, grown from a few points over the whole view.
//
// Match propagation (Lhuillier and Quan, PAMI 2002), on the sphere and along known epipolar curves:
// a cell of the first view that was found in the second says at which depth and on which plane its
// neighbours should be, and the best cell goes on first.
#pragma once

#include <cstdint>
#include <vector>

#include "core/surfaces/patches.h"

namespace epi360 {

// Directions spread evenly over the sphere, with the neighbours of each, the nearest first.
struct SphereGrid {
  std::size_t count;
  const float* directions;         // (count, 3)
  const std::int32_t* neighbours;  // (count, kNeighbours): where surfaces grow to
  const std::int32_t* around;      // (count, kAround): what says where a cell must be

  static constexpr int kNeighbours = 8, kAround = 24;

  Vec3f direction(std::size_t i) const {
    return {directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]};
  }
};

struct Seeds {
  std::size_t count;
  const std::int32_t* cells;
  const float* depths;
};

// All arrays have one row for each cell; a depth of 0 and a likeness of -1 say "not found".
struct SharedSurfaces {
  std::vector<float> contrast;
  std::vector<float> depth, likeness, normal;  // (count), (count), (count, 3)
  // Depth that the cells around say, and how alike both views look there; 0 and -1 where fewer
  // than five are found.
  std::vector<float> expected_depth, expected_likeness;
};

SharedSurfaces grow_surfaces(const PanoramaPair& pair, const SphereGrid& grid, const Seeds& seeds);

}  // namespace epi360
