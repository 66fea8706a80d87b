// SPDX-License-Identifier: BSD-3-Clause
// The robust estimator: pairs of arrays in, results with named fields out.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "core/robust/derivative_noise.h"
#include "core/robust/pairs.h"

using namespace nanobind::literals;

namespace epi360 {
namespace {

// The arrays of one pair, which live as long as this.
struct Pair {
  Bearings bearings1, bearings2;
  std::optional<Weights> weights, scores;
  std::optional<Jacobians> jacobians1, jacobians2;
  std::optional<Vector3> gravity1, gravity2;
  double gravity_sigma, elevation_sigma;
  std::uint64_t seed;
  double min_noise, max_noise;

  PairInput input() const {
    const std::size_t n = bearings1.shape(0);
    bool is_long_enough = bearings2.shape(0) == n;
    const auto pointer = [&](const auto& array) -> const double* {
      is_long_enough = is_long_enough && (!array || array->shape(0) == n);
      return array ? array->data() : nullptr;
    };
    const PairInput input{n,
                          bearings1.data(),
                          bearings2.data(),
                          pointer(weights),
                          pointer(scores),
                          pointer(jacobians1),
                          pointer(jacobians2),
                          gravity1 ? gravity1->data() : nullptr,
                          gravity2 ? gravity2->data() : nullptr,
                          gravity_sigma,
                          elevation_sigma,
                          seed,
                          min_noise,
                          max_noise};
    if (!is_long_enough) throw nb::value_error("all arrays of a pair must have the same length");
    return input;
  }
};

// A view of numbers inside a result, which stays alive with it.
template <typename T>
nb::object view(nb::handle result, T* values, std::initializer_list<std::size_t> shape) {
  return nb::ndarray<nb::numpy, T>(values, shape.size(), shape.begin(), result).cast();
}

std::vector<PairResult> estimate(const std::vector<const Pair*>& pairs, const std::string& residual,
                                 double threshold, bool threshold_in_pixels, int sample_size,
                                 int min_iterations, int max_iterations, double confidence,
                                 int min_num_inliers, double shared_error, int num_threads) {
  const RobustOptions options{
      residual_named(residual), threshold,  threshold_in_pixels, sample_size, min_iterations,
      max_iterations,           confidence, min_num_inliers,     shared_error};
  std::vector<PairInput> inputs;
  for (const Pair* pair : pairs) inputs.push_back(pair->input());
  for (const PairInput& input : inputs) {
    if (options.residual == Residual::kTangentSampson && !(input.jacobians1 && input.jacobians2)) {
      throw nb::value_error("tangent_sampson needs the Jacobians of both views");
    }
  }
  nb::gil_scoped_release unlocked;
  return estimate_pairs(inputs, options, num_threads);
}

void bind_result(nb::module_& m) {
  const auto robust = [](nb::handle self) -> RobustResult& {
    return nb::cast<PairResult&>(self).robust;
  };
  nb::class_<PairResult>(m, "PairResult")
      .def_prop_ro("status", [](const PairResult& r) { return name_of(r.robust.verdict.status); })
      .def_prop_ro("warnings", [](const PairResult& r) { return r.robust.verdict.warnings; })
      .def_prop_ro("rotation",
                   [](const PairResult& r) { return matrix(r.robust.cam2_from_cam1.R); })
      .def_prop_ro("translation",
                   [](const PairResult& r) { return vector(r.robust.cam2_from_cam1.t); })
      .def_prop_ro("scale", [](const PairResult& r) { return r.robust.scale; })
      .def_prop_ro("noise", [](const PairResult& r) { return r.robust.evidence.noise; })
      .def_prop_ro("threshold", [](const PairResult& r) { return r.robust.threshold; })
      .def_prop_ro("probability", [](const PairResult& r) { return r.robust.probability; })
      .def_prop_ro("explanations", [](const PairResult& r) { return explain(r.robust.evidence); })
      .def_prop_ro("evidence", [](const PairResult& r) { return r.robust.evidence; })
      .def_prop_ro("log_ratio", [](const PairResult& r) { return r.robust.evidence.log_ratio; })
      .def_prop_ro("regional_sigma",
                   [](const PairResult& r) { return r.robust.evidence.regional_sigma; })
      .def_prop_ro("direction_sigma",
                   [](const PairResult& r) { return r.robust.evidence.direction_sigma; })
      .def_prop_ro("rotation_sigma",
                   [](const PairResult& r) { return r.robust.evidence.rotation_sigma; })
      .def_prop_ro("rotation_rejection",
                   [](const PairResult& r) { return r.robust.evidence.rotation_rejection; })
      .def_prop_ro("parallax", [](const PairResult& r) { return r.robust.parallax; })
      .def_prop_ro("coverage", [](const PairResult& r) { return r.robust.evidence.coverage; })
      .def_prop_ro("num_iterations", [](const PairResult& r) { return r.robust.num_iterations; })
      .def_prop_ro("inlier_mask",
                   [=](nb::handle self) {
                     std::vector<unsigned char>& flags = robust(self).inlier;
                     return view(self, reinterpret_cast<bool*>(flags.data()), {flags.size()});
                   })
      .def_prop_ro("residuals",
                   [=](nb::handle self) {
                     std::vector<double>& values = robust(self).residuals;
                     return view(self, values.data(), {values.size()});
                   })
      .def_prop_ro(
          "covariance",
          [=](nb::handle self) { return view(self, robust(self).covariance.data(), {5, 5}); })
      .def_prop_ro("translation_basis",
                   [=](nb::handle self) {
                     return view(self, robust(self).translation_basis.data(), {3, 2});
                   })
      .def_prop_ro("alternatives",
                   [](const PairResult& r) {
                     nb::list poses;
                     for (const RelativePose& p : r.robust.alternatives)
                       poses.append(pose_tuple(p));
                     return poses;
                   })
      .def_prop_ro("bad_row",
                   [](const PairResult& r) {
                     return nb::make_tuple(r.bad_row.view, r.bad_row.row, r.bad_row.is_infinite);
                   })
      .def_ro("seconds", &PairResult::seconds);
}

}  // namespace

void bind_robust(nb::module_& m) {
  nb::class_<Warning>(m, "Warning")
      .def_prop_ro("code", [](const Warning& w) { return name_of(w.code); })
      .def_ro("value", &Warning::value)
      .def_ro("reference", &Warning::reference);
  nb::class_<Explanations>(m, "Explanations")
      .def_ro("nothing", &Explanations::nothing)
      .def_ro("rotation", &Explanations::rotation)
      .def_ro("surface", &Explanations::surface)
      .def_ro("motion", &Explanations::motion)
      .def_ro("rival", &Explanations::rival);
  bind_result(m);
  nb::class_<Pair>(m, "Pair").def(
      "__init__",
      [](Pair* pair, Bearings bearings1, Bearings bearings2, std::optional<Weights> weights,
         std::optional<Weights> scores, std::optional<Jacobians> jacobians1,
         std::optional<Jacobians> jacobians2, std::optional<Vector3> gravity1,
         std::optional<Vector3> gravity2, double gravity_sigma, double elevation_sigma,
         std::uint64_t seed, double min_noise, double max_noise) {
        new (pair) Pair{bearings1,  bearings2, weights,  scores,        jacobians1,
                        jacobians2, gravity1,  gravity2, gravity_sigma, elevation_sigma,
                        seed,       min_noise, max_noise};
      },
      "bearings1"_a, "bearings2"_a, nb::kw_only(), "weights"_a.none() = nb::none(),
      "scores"_a.none() = nb::none(), "jacobians1"_a.none() = nb::none(),
      "jacobians2"_a.none() = nb::none(), "gravity1"_a.none() = nb::none(),
      "gravity2"_a.none() = nb::none(), "gravity_sigma"_a = 0.0, "elevation_sigma"_a = 0.0,
      "seed"_a = 0, "min_noise"_a = 0.0, "max_noise"_a = 0.0);
  m.def("estimate_relative_poses", &estimate, "pairs"_a, nb::kw_only(), "residual"_a, "threshold"_a,
        "threshold_in_pixels"_a, "sample_size"_a, "min_iterations"_a, "max_iterations"_a,
        "confidence"_a, "min_num_inliers"_a, "shared_error"_a, "num_threads"_a);
  m.def(
      "noise_per_residual",
      [](const std::string& name) { return noise_per_residual(residual_named(name)); },
      "residual"_a);
}

}  // namespace epi360
