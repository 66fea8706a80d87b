// SPDX-License-Identifier: BSD-3-Clause
// Parts of the core that tests look at one by one: epi360._core.internals.
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <vector>

#include "bindings/arrays.h"
#include "core/refinement/refine.h"
#include "core/robust/displacement.h"
#include "core/robust/evidence.h"
#include "core/robust/grid_noise.h"
#include "core/robust/one_side.h"
#include "core/robust/plane.h"
#include "core/robust/ransac.h"
#include "core/robust/rotation_search.h"
#include "core/robust/rotation_test.h"
#include "core/robust/verdict.h"
#include "core/solvers/rotation.h"

using namespace nanobind::literals;

namespace epi360 {

void bind_testimony(nb::module_& m);  // testimony.cpp

namespace {

using Mask = nb::ndarray<const bool, nb::shape<-1>, nb::c_contig, nb::device::cpu>;

void bind_verdict(nb::module_& m) {
  nb::class_<Evidence>(m, "Evidence")
      .def(nb::init<>())
      .def_rw("num_matches", &Evidence::num_matches)
      .def_rw("num_copies", &Evidence::num_copies)
      .def_rw("num_fixed", &Evidence::num_fixed)
      .def_rw("num_usable", &Evidence::num_usable)
      .def_rw("num_effective", &Evidence::num_effective)
      .def_rw("sample_size", &Evidence::sample_size)
      .def_rw("support", &Evidence::support)
      .def_rw("log10_false_alarms", &Evidence::log10_false_alarms)
      .def_rw("chance", &Evidence::chance)
      .def_rw("parallax", &Evidence::parallax)
      .def_rw("scale", &Evidence::scale)
      .def_rw("rotation_support", &Evidence::rotation_support)
      .def_rw("rotation_log10_false_alarms", &Evidence::rotation_log10_false_alarms)
      .def_rw("rotation_rejection", &Evidence::rotation_rejection)
      .def_rw("num_displaced", &Evidence::num_displaced)
      .def_rw("displaced_rejection", &Evidence::displaced_rejection)
      .def_rw("rotation_log_ratio", &Evidence::rotation_log_ratio)
      .def_rw("turn_sigma", &Evidence::turn_sigma)
      .def_rw("rotation_sigma", &Evidence::rotation_sigma)
      .def_rw("direction_sigma", &Evidence::direction_sigma)
      .def_rw("log_ratio", &Evidence::log_ratio)
      .def_rw("regional_sigma", &Evidence::regional_sigma)
      .def_rw("num_regions", &Evidence::num_regions)
      .def_rw("has_prior", &Evidence::has_prior)
      .def_rw("log_prior", &Evidence::log_prior)
      .def_rw("rival_probability", &Evidence::rival_probability)
      .def_rw("rival_regions", &Evidence::rival_regions)
      .def_rw("num_contradicting", &Evidence::num_contradicting)
      .def_rw("is_only_crowd", &Evidence::is_only_crowd)
      .def_rw("only_pose", &Evidence::only_pose)
      .def_rw("only_rival", &Evidence::only_rival)
      .def_rw("behind", &Evidence::behind)
      .def_rw("mirrored_turn", &Evidence::mirrored_turn)
      .def_rw("tilt", &Evidence::tilt)
      .def_rw("tilt_sigma", &Evidence::tilt_sigma)
      .def_rw("rival_evidence", &Evidence::rival_evidence)
      .def_rw("plane_share", &Evidence::plane_share)
      .def_rw("has_twin", &Evidence::has_twin)
      .def_rw("num_distinct", &Evidence::num_distinct)
      .def_rw("min_num_inliers", &Evidence::min_num_inliers)
      .def_rw("spread", &Evidence::spread)
      .def_rw("spread_of_matches", &Evidence::spread_of_matches)
      .def_rw("pose_coverage", &Evidence::pose_coverage)
      .def_rw("coverage", &Evidence::coverage)
      .def_rw("match_coverage", &Evidence::match_coverage)
      .def_rw("noise", &Evidence::noise)
      .def_rw("max_noise", &Evidence::max_noise);
  m.def("explain", [](const Evidence& evidence) { return explain(evidence); }, "evidence"_a);
  m.def(
      "judge",
      [](const Evidence& evidence) {
        const Verdict verdict = judge(evidence);
        return nb::make_tuple(name_of(verdict.status), verdict.warnings);
      },
      "evidence"_a);
}

std::vector<std::vector<std::uint32_t>> draw(std::uint32_t num_matches, int sample_size,
                                             bool progressive, int num_samples,
                                             std::uint64_t seed) {
  Sampler sampler(num_matches, sample_size, progressive);
  Random random(seed);
  std::vector<std::vector<std::uint32_t>> samples(num_samples);
  for (std::vector<std::uint32_t>& sample : samples) {
    sample.resize(static_cast<std::size_t>(sample_size));
    sampler.draw(random, sample.data());
  }
  return samples;
}

// A problem of the loop that counts how it is used: its models are the numbers of a sample, the
// smaller the better.
struct CountingProblem {
  using Model = double;
  static constexpr int kMaxModels = 1;
  mutable int num_scored = 0;
  int sample_size() const { return 1; }
  int generate(const std::uint32_t* sample, Model* models) const {
    models[0] = sample[0];
    return 1;
  }
  double score(const Model& model, double) const {
    ++num_scored;
    return model;
  }
  void refine(Model& model) const { model -= 0.5; }
};

// (best model, its score, samples drawn) where a share of the matches are inliers.
nb::tuple run_loop(std::uint32_t num_matches, double inlier_share, int min_iterations,
                   int max_iterations, double confidence, std::uint64_t seed) {
  CountingProblem problem;
  Sampler sampler(num_matches, 1);
  Random random(seed);
  NoPool none;
  LoopResult<double> result;
  ransac(
      problem, sampler, {min_iterations, max_iterations, confidence}, random, none,
      [&](double) { return inlier_share; }, result);
  return nb::make_tuple(result.model, result.score, result.num_iterations);
}

}  // namespace

void bind_internals(nb::module_& module) {
  nb::module_ m = module.def_submodule("internals");
  bind_verdict(m);
  bind_testimony(m);
  m.def("draw", &draw, "num_matches"_a, "sample_size"_a, "progressive"_a, "num_samples"_a,
        "seed"_a);
  m.def(
      "iterations_needed",
      [](double inlier_ratio, int sample_size, int min_iterations, int max_iterations,
         double confidence) {
        return iterations_needed(inlier_ratio, sample_size,
                                 {min_iterations, max_iterations, confidence});
      },
      "inlier_ratio"_a, "sample_size"_a, "min_iterations"_a = 1, "max_iterations"_a = 1 << 30,
      "confidence"_a = 0.99);
  m.def("run_loop", &run_loop, "num_matches"_a, "inlier_share"_a, "min_iterations"_a,
        "max_iterations"_a, "confidence"_a, "seed"_a);
  m.def("log10_false_alarms", &log10_false_alarms, "num_matches"_a, "num_inliers"_a,
        "probability"_a, "sample_size"_a);
  m.def(
      "chance_density",
      [](Bearings b1, Bearings b2, Matrix3 R, Vector3 t, const std::string& residual, double range,
         std::uint64_t seed) {
        return ChanceDensity(to_matches(b1, b2), residual_named(residual), seed)
            .at(to_pose(R, t), range);
      },
      "bearings1"_a, "bearings2"_a, "rotation"_a, "translation"_a, "residual"_a, "range"_a,
      "seed"_a);
  m.def(
      "sides_that_say_most",
      [](Bearings b1, Bearings b2, Matrix3 R, Vector3 t, const std::vector<bool>& inliers) {
        return sides_that_say_most(to_matches(b1, b2), Residual::kSampson, to_pose(R, t),
                                   {inliers.begin(), inliers.end()});
      },
      "bearings1"_a, "bearings2"_a, "rotation"_a, "translation"_a, "inliers"_a);
  m.def(
      "density_in_view",
      [](Bearings b1, Bearings b2) { return density_in_view(to_matches(b1, b2)); }, "bearings1"_a,
      "bearings2"_a);
  m.def(
      "displacements",
      [](Bearings b1, Bearings b2) {
        const Matches matches = to_matches(b1, b2);
        std::vector<double> sines = displacements(matches);
        sines.resize(matches.size);
        return sines;
      },
      "bearings1"_a, "bearings2"_a);
  m.def(
      "log_odds_over_chance",
      [](Bearings b1, Bearings b2, Matrix3 R, Vector3 t, double scale,
         const std::vector<double>& shares, double outlier_density, double depth_tolerance) {
        const Matches matches = to_matches(b1, b2);
        std::vector<double> residuals(matches.padded), margins(matches.padded);
        compute_residuals(matches, Residual::kSampson, plain(to_pose(R, t)), residuals.data(),
                          margins.data());
        LossModel mixture;
        mixture.loss = Loss::kMixture;
        mixture.scale = scale;
        mixture.outlier_density = outlier_density;
        for (std::size_t k = 0; k < shares.size(); ++k) mixture.share[k] = shares[k];
        return log_odds_over_chance(matches, displacements(matches), residuals.data(),
                                    margins.data(), depth_tolerance, mixture);
      },
      "bearings1"_a, "bearings2"_a, "rotation"_a, "translation"_a, "scale"_a, "shares"_a,
      "outlier_density"_a, "depth_tolerance"_a);
  m.def(
      "rotation_chance",
      [](Bearings b1, Bearings b2, Matrix3 R, double gate, std::uint64_t seed) {
        return ChanceDensity(to_matches(b1, b2), Residual::kSampson, seed)
            .rotation_share(to_matrix(R), gate);
      },
      "bearings1"_a, "bearings2"_a, "rotation"_a, "gate"_a, "seed"_a);
  m.def(
      "fit_plane",
      [](Bearings b1, Bearings b2, Matrix3 R, Vector3 t, double gate) {
        const Matches matches = to_matches(b1, b2);
        double share = 0.0;
        const std::vector<unsigned char> all(matches.size, 1);
        const Eigen::Vector3d n = fit_plane(matches, to_pose(R, t), all, gate, &share);
        return nb::make_tuple(vector(n), share);
      },
      "bearings1"_a, "bearings2"_a, "rotation"_a, "translation"_a, "gate"_a);
  m.def(
      "twin_pose",
      [](Matrix3 R, Vector3 t, Vector3 normal) -> nb::object {
        RelativePose twin;
        const Eigen::Map<const Eigen::Vector3d> n(normal.data());
        return twin_pose(to_pose(R, t), n, &twin) ? pose_tuple(twin) : nb::none();
      },
      "rotation"_a, "translation"_a, "normal"_a);
  m.def(
      "align_rotations",
      [](Bearings b1, Bearings b2, Weights weights) {
        if (weights.shape(0) != b1.shape(0)) throw nb::value_error("one weight for each match");
        return matrix(align_rotations(to_matches(b1, b2), weights.data()));
      },
      "bearings1"_a, "bearings2"_a, "weights"_a);
  m.def(
      "grid_noise", [](Bearings b1, Bearings b2) { return grid_noise(to_matches(b1, b2)); },
      "bearings1"_a, "bearings2"_a);
  m.def(
      "best_rotation",
      [](Bearings b1, Bearings b2, double gate, std::uint64_t seed) {
        Random random(seed);
        RotationFit fit = best_rotation(to_matches(b1, b2), gate, random);
        return nb::make_tuple(matrix(fit.R), taken(std::move(fit.residuals)), fit.support);
      },
      "bearings1"_a, "bearings2"_a, "gate"_a, "seed"_a);
  m.def(
      "test_rotation",
      [](Bearings b1, Bearings b2, Mask inlier, const Matrix3& rotation, double scale, double gate,
         double independent, double hidden) {
        if (inlier.shape(0) != b1.shape(0)) throw nb::value_error("one flag for each match");
        const std::vector<unsigned char> chosen(inlier.data(), inlier.data() + inlier.shape(0));
        const RotationTest test = test_rotation(to_matches(b1, b2), chosen, to_matrix(rotation),
                                                scale, gate, {independent, hidden});
        return nb::make_tuple(test.by_median, test.by_displaced, test.num_displaced,
                              test.all_around);
      },
      "bearings1"_a, "bearings2"_a, "inlier"_a, "rotation"_a, "scale"_a, "gate"_a, "independent"_a,
      "hidden"_a);
}

}  // namespace epi360
