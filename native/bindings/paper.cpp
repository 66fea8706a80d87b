// SPDX-License-Identifier: BSD-3-Clause
// The paper's estimators: arrays in, arrays out. Values are checked in Python.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include "bindings/arrays.h"
#include "core/paper/methods.h"

using namespace nanobind::literals;
namespace epi360 {
namespace {

Matches at_least_eight(const Bearings& b1, const Bearings& b2,
                       const std::optional<Weights>& weights = {}) {
  if (b1.shape(0) < 8) throw nb::value_error("at least eight matches are needed");
  return to_matches(b1, b2, weights);
}

SkSearch search_named(const std::string& name) {
  if (name == "line") return SkSearch::kLine;
  if (name == "lm") return SkSearch::kLm;
  refuse("sk_search", name);
}

Parameterization parameterization_named(const std::string& name) {
  if (name == "manifold") return Parameterization::kManifold;
  if (name == "se3") return Parameterization::kSe3;
  refuse("parameterization", name);
}

Normalization normalization_named(const std::string& name) {
  if (name == "none") return Normalization::kNone;
  if (name == "isotropic") return Normalization::kIsotropic;
  if (name == "non_isotropic") return Normalization::kNonIsotropic;
  if (name == "isotropic+non_isotropic") return Normalization::kIsotropicNonIsotropic;
  if (name == "given") return Normalization::kGiven;
  refuse("normalization", name);
}

nb::tuple paper_pose_binding(const Bearings& b1, const Bearings& b2, const std::string& name,
                             const std::string& sk_search, const std::string& parameterization) {
  PaperMethod method;
  if (!paper_method_named(name, &method)) refuse("method", name);
  const SkSearch search = search_named(sk_search);
  const Parameterization chart = parameterization_named(parameterization);
  const PaperPose result =
      unlocked([&] { return paper_pose(at_least_eight(b1, b2), method, search, chart); });
  return nb::make_tuple(matrix(result.cam2_from_cam1.R), vector(result.cam2_from_cam1.t), result.S,
                        result.K, result.cost, result.num_evaluations, result.num_iterations,
                        result.converged);
}

nb::tuple solve_linear_binding(const Bearings& b1, const Bearings& b2, const std::string& name,
                               bool taubin, double S, double K, std::optional<Weights> weights) {
  const Normalization normalization = normalization_named(name);
  const Constraint constraint = taubin ? Constraint::kTaubin : Constraint::kUnit;
  const LinearSolution solution = unlocked([&] {
    return solve_linear(at_least_eight(b1, b2, weights), normalization, constraint, S, K);
  });
  return nb::make_tuple(matrix(solution.E), matrix(solution.N1), matrix(solution.N2));
}

nb::tuple search_sk_binding(const Bearings& b1, const Bearings& b2, const std::string& sk_search,
                            std::optional<Weights> weights) {
  const SkSearch search = search_named(sk_search);
  const SkResult result = unlocked([&] {
    const Matches m = at_least_eight(b1, b2, weights);
    SkCost cost(m);
    return epi360::search_sk(cost, search);
  });
  return nb::make_tuple(result.S, result.K, result.cost, result.num_evaluations);
}

}  // namespace

void bind_paper(nb::module_& m) {
  m.def("paper_pose", &paper_pose_binding, "bearings1"_a, "bearings2"_a, "method"_a,
        "sk_search"_a = "line", "parameterization"_a = "manifold");
  m.def("solve_linear", &solve_linear_binding, "bearings1"_a, "bearings2"_a, "normalization"_a,
        "taubin"_a = false, "S"_a = 1.0, "K"_a = 1.0, "weights"_a.none() = nb::none());
  m.def("search_sk", &search_sk_binding, "bearings1"_a, "bearings2"_a, "sk_search"_a,
        "weights"_a.none() = nb::none());
}

}  // namespace epi360
