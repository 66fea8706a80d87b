// SPDX-License-Identifier: BSD-3-Clause
// Numbers that more than one file needs. A number that one file needs stands there.
#pragma once

namespace epi360 {

constexpr double kPi = 3.141592653589793;
constexpr double kDegree = 0.017453292519943295;          // radians
constexpr double kInverseRootTwoPi = 0.3989422804014327;  // peak of the unit Gaussian

// Standard deviation (radians) that refinement does not go below: exact data must not drive the
// mixture to zero.
constexpr double kSmallestScale = 1e-6;

// Density per radian of the residuals of wrong matches in front of both cameras: measured.
constexpr double kTypicalDensity = 0.35;

// Parallax of the wrong sign (radians) that noise may cause: depths must be right beyond it.
constexpr double kLargestWrongParallax = 0.07;

}  // namespace epi360
