// SPDX-License-Identifier: BSD-3-Clause
// Matches of two views as structure of arrays: what every hot loop reads.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "core/constants.h"

namespace epi360 {

// Bearings are unit vectors. Arrays are padded to a multiple of kBlock with copies of a harmless
// match of weight zero, so that loops run over whole blocks.
struct Matches {
  static constexpr std::size_t kBlock = 32;

  std::size_t size = 0;    // matches
  std::size_t padded = 0;  // length of each array
  std::vector<double> x1, y1, z1, x2, y2, z2;
  std::vector<double> weight;
  bool unit_weights = true;  // every match has weight 1
  // Standard deviation of the residuals (radians) below which they are not believed.
  double least_scale = kSmallestScale;
  // Columns of the cameras' unprojection Jacobians, only for tangent Sampson: u1 = d b1 / d column.
  std::vector<double> u1x, u1y, u1z, v1x, v1y, v1z, u2x, u2y, u2z, v2x, v2y, v2z;

  bool has_jacobians() const { return !u1x.empty(); }
};

// n copies of the padding match, to be filled one by one with row-major bearings (3) and Jacobians
// (3, 2), and cut to those that were filled.
Matches padding_matches(std::size_t n, bool with_jacobians);
void set_bearings(Matches& m, std::size_t i, const double* bearing1, const double* bearing2);
void set_jacobians(Matches& m, std::size_t i, const double* jacobian1, const double* jacobian2);
void truncate(Matches& m, std::size_t n);

// The entries of one view's Jacobians in row-major order: 1 or 2.
std::array<std::vector<double>*, 6> jacobian_columns(Matches& m, int view);

// bearings: (n, 3) row-major; weights: (n) or null; jacobians: (n, 3, 2) row-major or null.
Matches make_matches(const double* bearings1, const double* bearings2, std::size_t n,
                     const double* weights = nullptr, const double* jacobians1 = nullptr,
                     const double* jacobians2 = nullptr);

// View 1 of some rows with view 2 of others, in the given order; the weights are those of view 1.
Matches paired_matches(const Matches& m, const std::vector<std::size_t>& rows1,
                       const std::vector<std::size_t>& rows2);

// Some of the matches, in the given order.
Matches chosen_matches(const Matches& m, const std::vector<std::size_t>& indices);

}  // namespace epi360
