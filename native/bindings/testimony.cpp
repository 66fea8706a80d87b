// SPDX-License-Identifier: BSD-3-Clause
// What speaks for a pose, for tests: part of epi360._core.internals.
#include <nanobind/stl/string.h>

#include "bindings/arrays.h"
#include "core/robust/derivative_noise.h"
#include "core/robust/neighbourhoods.h"
#include "core/robust/shared_error.h"
#include "core/robust/testimony.h"
#include "core/robust/upright_search.h"

using namespace nanobind::literals;

namespace epi360 {
namespace {

// Residuals and derivatives at a pose, with the matches' own weights.
Linearisation linearised(const Matches& m, const RelativePose& pose, Residual residual) {
  const Eigen::Matrix<double, 3, 2, Eigen::RowMajor> basis = tangent_basis(pose.t);
  Linearisation at;
  at.resize(m.padded);
  compute_jacobians(m, residual, plain(pose), basis.data(), at.residuals.data(), at.margins.data(),
                    at.jacobian.data());
  std::copy(m.weight.begin(), m.weight.end(), at.weights.begin());
  return at;
}

// The entries (25) of a covariance, row by row.
auto rows_of(const Eigen::Matrix<double, 5, 5, Eigen::RowMajor>& covariance) {
  return taken(std::vector<double>(covariance.data(), covariance.data() + 25));
}

}  // namespace

void bind_testimony(nb::module_& m) {
  m.def(
      "testimony",
      [](Bearings b1, Bearings b2, Matrix3 R, Vector3 t, double scale, double gate, double density,
         const std::string& residual, std::uint64_t seed) {
        const Testimony found = testimony(to_matches(b1, b2), residual_named(residual),
                                          to_pose(R, t), scale, gate, density, PosePrior{}, seed);
        return nb::make_tuple(found.log_ratio, found.direction_sigma);
      },
      "bearings1"_a, "bearings2"_a, "rotation"_a, "translation"_a, nb::kw_only(), "scale"_a,
      "gate"_a, "density"_a, "residual"_a = "sampson", "seed"_a = 0);
  m.def(
      "rotation_log_ratio",
      [](Bearings b1, Bearings b2, Matrix3 R, double scale, double gate, double share,
         std::uint64_t seed) {
        return rotation_log_ratio(to_matches(b1, b2), to_matrix(R), scale, gate, share, seed);
      },
      "bearings1"_a, "bearings2"_a, "rotation"_a, nb::kw_only(), "scale"_a, "gate"_a, "share"_a,
      "seed"_a = 0);
  m.def(
      "shared_error_covariance",
      [](Bearings b1, Bearings b2, Matrix3 R, Vector3 t, double scale, double least) {
        const Matches m = to_matches(b1, b2);
        const RelativePose pose = to_pose(R, t);
        const Linearisation at = linearised(m, pose, Residual::kSampson);
        return rows_of(shared_error(m, pose, at, scale, least).covariance);
      },
      "bearings1"_a, "bearings2"_a, "rotation"_a, "translation"_a, "scale"_a, "least"_a);
  m.def(
      "independent_share",
      [](Bearings b1, Bearings b2, double shared) {
        const Matches m = to_matches(b1, b2);
        return independent_share(m, std::vector<unsigned char>(m.size, 1), shared);
      },
      "bearings1"_a, "bearings2"_a, "shared"_a);
  m.def(
      "errors_in_variables",
      [](Bearings b1, Bearings b2, Matrix3 R, Vector3 t, double scale,
         const std::string& residual) {
        const Matches m = to_matches(b1, b2);
        const RelativePose pose = to_pose(R, t);
        const Residual kind = residual_named(residual);
        return rows_of(errors_in_variables(
            noisy_information(m, kind, pose, linearised(m, pose, kind), scale * scale)));
      },
      "bearings1"_a, "bearings2"_a, "rotation"_a, "translation"_a, "scale"_a,
      "residual"_a = "sampson");
  m.def(
      "region_weights",
      [](Bearings b1, Bearings b2) { return taken(region_weights(to_matches(b1, b2))); },
      "bearings1"_a, "bearings2"_a);
  m.def(
      "one_of_each_region",
      [](Bearings b1, Bearings b2) { return one_of_each_region(to_matches(b1, b2)); },
      "bearings1"_a, "bearings2"_a);
  m.def(
      "upright_poses",
      [](Bearings b1, Bearings b2, Vector3 gravity1, Vector3 gravity2, int most) {
        const auto direction = [](const Vector3& g) { return Eigen::Vector3d(g(0), g(1), g(2)); };
        PosePrior prior;
        prior.has_gravity = true;
        prior.gravity1 = direction(gravity1);
        prior.gravity2 = direction(gravity2);
        nb::list poses;
        for (const RelativePose& pose : upright_poses(to_matches(b1, b2), prior, most)) {
          poses.append(pose_tuple(pose));
        }
        return poses;
      },
      "bearings1"_a, "bearings2"_a, "gravity1"_a, "gravity2"_a, "most"_a);
}

}  // namespace epi360
