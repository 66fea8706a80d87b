// SPDX-License-Identifier: BSD-3-Clause
// How many matches agree with two upright cameras of which heading and direction are known. Plain
// loops over structure-of-arrays doubles, no Eigen: see multiversion.h.
#pragma once

#include <cstddef>
#include <vector>

namespace epi360 {

constexpr std::size_t kHeadingLanes = 8;

// Bearings in frames whose y axis is gravity, with the weight of each match; padded to whole lanes
// with matches of weight zero.
struct LevelMatches {
  explicit LevelMatches(std::size_t n);
  std::size_t padded() const { return weight.size(); }
  std::vector<double> x1, y1, z1, x2, y2, z2, weight;
};

// What the matches contribute for a horizontal direction, once view 1 is turned by a heading.
struct TurnedMatches {
  explicit TurnedMatches(std::size_t padded);
  std::vector<double> ax, az, nx, nz, depth1x, depth1z, depth2x, depth2z, limit;
};

void turn_matches(const LevelMatches& m, double heading, TurnedMatches& out);

// Weights of the matches that agree with the horizontal direction (x, z), and with the opposite
// one: each by (1 - (r / reach)^2)^2 of its Sampson distance r, in front of both cameras.
void score_direction(const LevelMatches& m, const TurnedMatches& turned, double x, double z,
                     double reach, double* forth, double* back);

}  // namespace epi360
