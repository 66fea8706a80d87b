// SPDX-License-Identifier: BSD-3-Clause
// Thin: arrays in, arrays out. Shapes and values are checked in Python, where the messages are.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <algorithm>
#include <limits>
#include <vector>

#include "bindings/arrays.h"
#include "core/paper/methods.h"
#include "core/refinement/fit_mixture.h"
#include "core/refinement/refine.h"
#include "core/solvers/eight_point.h"
#include "core/solvers/five_point.h"
#include "core/solvers/upright.h"

using namespace nanobind::literals;
using namespace epi360;

namespace {

void check_jacobians(Residual residual, const Matches& m) {
  if (residual == Residual::kTangentSampson && !m.has_jacobians() && m.size > 0) {
    throw nb::value_error("tangent_sampson needs the Jacobians of both views");
  }
}

nb::list five_point_binding(Bearings b1, Bearings b2) {
  if (b1.shape(0) != 5 || b2.shape(0) != 5) throw nb::value_error("five matches are needed");
  Eigen::Matrix<double, 3, 3, Eigen::RowMajor> essentials[10];
  const int count = five_point(b1.data(), b2.data(), essentials[0].data());
  nb::list out;
  for (int k = 0; k < count; ++k) out.append(matrix(essentials[k]));
  return out;
}

nb::tuple refine_binding(Bearings b1, Bearings b2, Matrix3 R, Vector3 t,
                         const std::string& residual, const std::string& loss, double scale,
                         std::optional<Weights> weights, std::optional<Jacobians> j1,
                         std::optional<Jacobians> j2, int max_iterations) {
  const Matches m = to_matches(b1, b2, weights, j1, j2);
  RefineOptions options;
  options.residual = residual_named(residual);
  check_jacobians(options.residual, m);
  options.loss.loss = loss_named(loss);
  options.loss.scale = scale;
  options.max_iterations = max_iterations;
  RefineResult result;
  RefineWorkspace workspace;
  std::vector<double> residuals(m.padded), margins(m.padded);
  const RelativePose start = to_pose(R, t);
  {
    nb::gil_scoped_release unlocked;
    if (options.loss.loss == Loss::kMixture && !(scale > 0.0)) {
      compute_residuals(m, options.residual, plain(start), residuals.data(), margins.data());
      options.loss =
          fit_mixture(m, residuals.data(), margins.data(), std::numeric_limits<double>::infinity(),
                      options.loss.outlier_density, options.smallest_scale);
    }
    result = refine(m, start, options, workspace);
    set_statistics(m, workspace, result);
    compute_residuals(m, options.residual, plain(result.cam2_from_cam1), residuals.data(),
                      margins.data());
  }
  residuals.resize(m.size);
  return nb::make_tuple(
      matrix(result.cam2_from_cam1.R), vector(result.cam2_from_cam1.t), taken(std::move(residuals)),
      result.cost, copied(result.information.data(), 5, 5), result.weighted_squares,
      result.effective_matches, result.loss.scale, result.num_iterations, result.converged);
}

nb::list upright_binding(Bearings b1, Bearings b2, Vector3 gravity1, Vector3 gravity2) {
  if (b1.shape(0) != 3 || b2.shape(0) != 3) throw nb::value_error("three matches are needed");
  RelativePose poses[4];
  const auto columns = [](const Bearings& b) {
    return Eigen::Matrix3d(Eigen::Map<const Eigen::Matrix3d>(b.data()));
  };
  const auto upright = [](const Vector3& g) {
    return upright_from(Eigen::Map<const Eigen::Vector3d>(g.data()));
  };
  const int count =
      upright_three_point(columns(b1), columns(b2), upright(gravity1), upright(gravity2), poses);
  nb::list out;
  for (int k = 0; k < count; ++k) out.append(pose_tuple(poses[k]));
  return out;
}

}  // namespace

namespace epi360 {
void bind_paper(nb::module_& m);       // paper.cpp
void bind_robust(nb::module_& m);      // robust.cpp
void bind_internals(nb::module_& m);   // internals.cpp
void bind_adjustment(nb::module_& m);  // adjustment.cpp
void bind_features(nb::module_& m);    // features.cpp
void bind_surfaces(nb::module_& m);    // surfaces.cpp
void bind_angles(nb::module_& m);      // angles.cpp
}  // namespace epi360

NB_MODULE(_core, m) {
  bind_paper(m);
  bind_robust(m);
  bind_internals(m);
  bind_adjustment(m);
  bind_features(m);
  bind_surfaces(m);
  bind_angles(m);
  m.def("five_point", &five_point_binding, "bearings1"_a, "bearings2"_a);
  m.def(
      "eight_point",
      [](Bearings b1, Bearings b2, std::optional<Weights> weights) {
        const Matches m = to_matches(b1, b2, weights);
        return matrix(unlocked([&] { return eight_point(m); }));
      },
      "bearings1"_a, "bearings2"_a, "weights"_a.none() = nb::none());
  m.def(
      "pose_from_essential",
      [](Matrix3 E, Bearings b1, Bearings b2) {
        return pose_tuple(pose_from_essential(to_matches(b1, b2), to_matrix(E)));
      },
      "E"_a, "bearings1"_a, "bearings2"_a);
  m.def(
      "residuals",
      [](Bearings b1, Bearings b2, Matrix3 R, Vector3 t, const std::string& kind,
         std::optional<Jacobians> j1, std::optional<Jacobians> j2) {
        const Matches matches = to_matches(b1, b2, {}, j1, j2);
        check_jacobians(residual_named(kind), matches);
        const RelativePose pose = to_pose(R, t);
        const Eigen::Matrix<double, 3, 2, Eigen::RowMajor> basis = tangent_basis(pose.t);
        std::vector<double> r(matches.padded), margins(matches.padded), J(5 * matches.padded);
        compute_jacobians(matches, residual_named(kind), plain(pose), basis.data(), r.data(),
                          margins.data(), J.data());
        std::vector<double> rows;
        for (std::size_t i = 0; i < matches.size; ++i) {
          for (std::size_t k = 0; k < 5; ++k) rows.push_back(J[k * matches.padded + i]);
        }
        r.resize(matches.size);
        return nb::make_tuple(taken(std::move(r)), copied(rows.data(), matches.size, 5));
      },
      "bearings1"_a, "bearings2"_a, "rotation"_a, "translation"_a, "kind"_a,
      "jacobians1"_a.none() = nb::none(), "jacobians2"_a.none() = nb::none());
  m.def("refine", &refine_binding, "bearings1"_a, "bearings2"_a, "rotation"_a, "translation"_a,
        nb::kw_only(), "residual"_a, "loss"_a, "scale"_a, "weights"_a.none(), "jacobians1"_a.none(),
        "jacobians2"_a.none(), "max_iterations"_a);
  m.def("upright_three_point", &upright_binding, "bearings1"_a, "bearings2"_a, "gravity1"_a,
        "gravity2"_a);
}
