// SPDX-License-Identifier: BSD-3-Clause
// Changes of the cameras' angles: epi360._core.fit_angle_changes and changed_by_a_turn.
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>

#include <tuple>

#include "bindings/arrays.h"
#include "core/angles/angle_fit.h"

using namespace nanobind::literals;

namespace epi360 {
namespace {

// Name of the angles, longitude of the middle and how far it is below the horizon (radians).
using Model = std::tuple<std::string, double, double>;

AngleModel to_model(const Model& model) {
  const auto& [name, longitude, down] = model;
  for (const auto& [known, angles] : {std::pair{"fixed", Angles::kFixed},
                                      {"radial", Angles::kRadial},
                                      {"focal", Angles::kFocal},
                                      {"curved", Angles::kCurved},
                                      {"panorama", Angles::kPanorama}}) {
    if (name == known) return {angles, longitude, down};
  }
  refuse("angles", name);
}

PairAngles to_angles(const Bearings& b1, const Bearings& b2, const Model& model1,
                     const Model& model2, bool is_one_camera) {
  if (b1.shape(0) != b2.shape(0) || b1.shape(0) == 0) {
    throw nb::value_error("both views need as many bearings, at least one");
  }
  const AngleModel first = to_model(model1), second = to_model(model2);
  return {ViewAngles(first, b1.data(), b1.shape(0)), ViewAngles(second, b2.data(), b2.shape(0)),
          is_one_camera};
}

Changes to_changes(const Weights& changes, const PairAngles& angles) {
  const int count = angles.num_changes();
  if (changes.shape(0) != static_cast<std::size_t>(count)) {
    throw nb::value_error("there must be as many changes as these cameras have");
  }
  return Eigen::Map<const Eigen::VectorXd>(changes.data(), count);
}

nb::object rows_of(const std::vector<double>& values, std::size_t rows) {
  return copied(values.data(), rows, values.size() / rows);
}

}  // namespace

void bind_angles(nb::module_& m) {
  m.def(
      "fit_angle_changes",
      [](const Bearings& b1, const Bearings& b2, const Model& model1, const Model& model2,
         bool is_one_camera, const Matrix3& rotation, const Vector3& translation,
         const Weights& changes, double noise) {
        const PairAngles angles = to_angles(b1, b2, model1, model2, is_one_camera);
        const RelativePose start = to_pose(rotation, translation);
        const Changes start_changes = to_changes(changes, angles);
        const AngleFit fit =
            unlocked([&] { return fit_angle_changes(angles, start, start_changes, noise); });
        const std::size_t count = fit.residuals.size();
        return nb::make_tuple(
            matrix(fit.cam2_from_cam1.R), vector(fit.cam2_from_cam1.t),
            copied(fit.changes.data(), fit.changes.size(), 0), fit.gain,
            copied(fit.residuals.data(), count, 0), rows_of(fit.jacobian, count),
            nb::make_tuple(rows_of(fit.gradients1, count), rows_of(fit.gradients2, count)),
            nb::make_tuple(rows_of(fit.bearings1, count), rows_of(fit.bearings2, count)));
      },
      "bearings1"_a, "bearings2"_a, "model1"_a, "model2"_a, "is_one_camera"_a, "rotation"_a,
      "translation"_a, "changes"_a, "noise"_a);
  m.def(
      "changed_by_a_turn",
      [](const Bearings& b1, const Bearings& b2, const Model& model1, const Model& model2,
         bool is_one_camera, const Matrix3& rotation, double noise) -> nb::object {
        const PairAngles angles = to_angles(b1, b2, model1, model2, is_one_camera);
        const Eigen::Matrix3d start = to_matrix(rotation);
        const auto found = unlocked([&] { return changed_by_a_turn(angles, start, noise); });
        return found ? copied(found->data(), found->size(), 0) : nb::object(nb::none());
      },
      "bearings1"_a, "bearings2"_a, "model1"_a, "model2"_a, "is_one_camera"_a, "rotation"_a,
      "noise"_a);
}

}  // namespace epi360
