// SPDX-License-Identifier: BSD-3-Clause
// Bearings by the angles that a wrong calibration makes too large or too small: of a lens those
// from its optical axis, of a panorama longitudes and latitudes. cameras.changed_angles is the
// twin.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

namespace epi360 {

enum class Angles {
  kFixed,   // nothing changes
  kRadial,  // the angle a from the axis is multiplied by 1 + the change
  kFocal,   // its tangent is, as by a shorter focal length
  kCurved,  // by 1 + the first change + the second one times a^2
  // Longitudes by 1 + the first change, latitudes by 1 + the second one, after which the third one
  // is added, in radians downwards.
  kPanorama,
};

constexpr int kMostChanges = 3;  // of one view

struct AngleModel {
  Angles angles;
  double longitude = 0.0, down = 0.0;  // of the middle of a panorama, in radians

  int num_changes() const {
    switch (angles) {
      case Angles::kFixed:
        return 0;
      case Angles::kRadial:
      case Angles::kFocal:
        return 1;
      case Angles::kCurved:
        return 2;
      default:
        return kMostChanges;
    }
  }
};

// A bearing with changed angles, and its derivatives: by the measured bearing along two unit
// tangents, and by the changes.
struct ChangedBearing {
  Eigen::Vector3d bearing;
  Eigen::Matrix<double, 3, 2> by_measured;
  Eigen::Matrix<double, 3, kMostChanges> by_changes;
};

// The bearings of one view.
class ViewAngles {
 public:
  // `bearings` has three numbers for each of `count`.
  ViewAngles(const AngleModel& model, const double* bearings, std::size_t count);

  std::size_t size() const { return angles_.size(); }
  int num_changes() const { return model_.num_changes(); }
  ChangedBearing changed(std::size_t i, const double* changes) const;

 private:
  // From the axis, and around it; or from the middle, to the right and down.
  struct Pair {
    double first, second;
  };

  AngleModel model_;
  std::vector<Pair> angles_;
};

}  // namespace epi360
