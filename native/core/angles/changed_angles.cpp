// SPDX-License-Identifier: BSD-3-Clause
#include "core/angles/changed_angles.h"

#include <algorithm>
#include <cmath>

#include "core/constants.h"

namespace epi360 {
namespace {

constexpr double kNearAxis = 1e-9;  // radians: there both sines are as their angles
constexpr double kNearPole = 1e-6;  // cosine of a latitude

ChangedBearing changed_radial(double angle, double around, double linear, double cubic) {
  const double square = angle * angle, factor = 1.0 + linear + cubic * square;
  const double larger = angle * factor, slope = 1.0 + linear + 3.0 * cubic * square;
  const double sine = std::sin(larger), cosine = std::cos(larger);
  const Eigen::Vector3d out(std::cos(around), std::sin(around), 0.0);
  const Eigen::Vector3d across(-out.y(), out.x(), 0.0), axis = Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d away = cosine * out - sine * axis;
  const double stretch = angle < kNearAxis ? factor : sine / std::sin(angle);
  ChangedBearing changed;
  changed.bearing = sine * out + cosine * axis;
  changed.by_measured << slope * away, stretch * across;
  changed.by_changes << angle * away, angle * square * away, Eigen::Vector3d::Zero();
  return changed;
}

// Tangents of the angle `angle` from the axis multiplied by `factor`.
ChangedBearing changed_focal(double angle, double around, double factor) {
  const double sine = std::sin(angle), cosine = std::cos(angle);
  const double length = std::hypot(factor * sine, cosine);
  const double sine_after = factor * sine / length, cosine_after = cosine / length;
  const Eigen::Vector3d out(std::cos(around), std::sin(around), 0.0);
  const Eigen::Vector3d across(-out.y(), out.x(), 0.0), axis = Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d away = cosine_after * out - sine_after * axis;
  ChangedBearing changed;
  changed.bearing = sine_after * out + cosine_after * axis;
  changed.by_measured << (factor / (length * length)) * away, (factor / length) * across;
  changed.by_changes << (sine * cosine / (length * length)) * away,
      Eigen::Matrix<double, 3, 2>::Zero();
  return changed;
}

ChangedBearing changed_panorama(const AngleModel& model, double right, double below,
                                const double* changes) {
  const double wider = 1.0 + changes[0], higher = 1.0 + changes[1], lowered = changes[2];
  const double longitude = model.longitude + wider * right;
  const double down = model.down + higher * below + lowered;
  const double sin_longitude = std::sin(longitude), cos_longitude = std::cos(longitude);
  const double sin_down = std::sin(down), cos_down = std::cos(down);
  const Eigen::Vector3d parallel = cos_down * Eigen::Vector3d(cos_longitude, 0.0, -sin_longitude);
  const Eigen::Vector3d meridian(-sin_down * sin_longitude, cos_down, -sin_down * cos_longitude);
  const double before = std::max(std::cos(model.down + below), kNearPole);
  ChangedBearing changed;
  changed.bearing << cos_down * sin_longitude, sin_down, cos_down * cos_longitude;
  changed.by_measured << (wider / before) * parallel, higher * meridian;
  changed.by_changes << right * parallel, below * meridian, meridian;
  return changed;
}

}  // namespace

ViewAngles::ViewAngles(const AngleModel& model, const double* bearings, std::size_t count)
    : model_(model) {
  angles_.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    const double x = bearings[3 * i], y = bearings[3 * i + 1], z = bearings[3 * i + 2];
    if (model.angles == Angles::kPanorama) {
      const double right = std::atan2(x, z) - model.longitude;
      const double turns = std::nearbyint(right / (2.0 * kPi));
      angles_.push_back({right - 2.0 * kPi * turns, std::atan2(y, std::hypot(x, z)) - model.down});
    } else {
      angles_.push_back({std::atan2(std::hypot(x, y), z), std::atan2(y, x)});
    }
  }
}

ChangedBearing ViewAngles::changed(std::size_t i, const double* changes) const {
  const Pair& angles = angles_[i];
  switch (model_.angles) {
    case Angles::kFixed:
      return changed_radial(angles.first, angles.second, 0.0, 0.0);
    case Angles::kRadial:
      return changed_radial(angles.first, angles.second, changes[0], 0.0);
    case Angles::kFocal:
      return changed_focal(angles.first, angles.second, 1.0 + changes[0]);
    case Angles::kCurved:
      return changed_radial(angles.first, angles.second, changes[0], changes[1]);
    default:
      return changed_panorama(model_, angles.first, angles.second, changes);
  }
}

}  // namespace epi360
