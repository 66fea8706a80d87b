// SPDX-License-Identifier: BSD-3-Clause
// What speaks for a pose, beyond its inlier count.
#pragma once

#include <cstdint>
#include <vector>

#include "core/matches.h"
#include "core/pose.h"
#include "core/residuals/residuals.h"

namespace epi360 {

// Density per radian of the signed residual of wrong matches near zero, from the matches
// themselves: view 2 is paired with view 1 at random, which keeps where the points lie and breaks
// what they say.
class ChanceDensity {
 public:
  ChanceDensity(const Matches& m, Residual residual, std::uint64_t seed);
  double at(const RelativePose& pose, double range) const;
  // Probability that a wrong match agrees with a rotation to within a gate (radians).
  double rotation_share(const Eigen::Matrix3d& R, double gate) const;

 private:
  Residual residual_;
  Matches shuffled_;
  mutable std::vector<double> residuals_, margins_;
};

// Density per radian of wrong residuals under a typical pose, from the length of the mean bearing
// of the wider view: kTypicalDensity where that is a hemisphere or more. In a narrower view a wrong
// match cannot be far from any epipolar curve. It is right to a third.
double density_in_view(const Matches& m);

// log10 of the expected number of poses with `inliers` of `matches` inside a gate that a wrong
// match passes with the given probability (a contrario; Moisan & Stival, IJCV 2004, for five
// points with up to ten solutions).
double log10_false_alarms(int matches, int inliers, double probability, int sample_size);

// Equal-area cells of the sphere: bands along y by sectors around it.
constexpr int kBands = 4, kSectors = 12, kNumCells = kBands * kSectors;
std::size_t cell_of(const Eigen::Vector3d& bearing);

// Where bearings lie, the lower number of both views.
struct Extent {
  double coverage = 0.0;  // share of 48 equal-area cells that hold one
  // One minus the length of the mean bearing: 0 for one direction, 0.06 for a cone of 40 degrees.
  double spread = 0.0;
};

struct Extents {
  Extent all, chosen;
};
Extents extents(const Matches& m, const unsigned char* chosen);

// Median angle between R b1 and b2 over the chosen matches, radians.
double median_parallax(const Matches& m, const RelativePose& pose, const unsigned char* chosen);

}  // namespace epi360
