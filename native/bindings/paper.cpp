// SPDX-License-Identifier: BSD-3-Clause
// The paper's estimators: arrays in, arrays out. Values are checked in Python.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <Eigen/Core>
#include <optional>
#include <stdexcept>

#include "core/paper_pose.h"
#include "core/paper_weights.h"

namespace nb = nanobind;
using namespace nb::literals;
using namespace epi360;

namespace {

using Bearings = nb::ndarray<const double, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Weights = nb::ndarray<const double, nb::shape<-1>, nb::c_contig, nb::device::cpu>;

nb::object array_of(const double* values, std::size_t rows, std::size_t columns) {
  const std::size_t count = rows * (columns > 0 ? columns : 1);
  double* owned = new double[count];
  std::copy(values, values + count, owned);
  nb::capsule owner(owned, [](void* p) noexcept { delete[] static_cast<double*>(p); });
  const std::size_t shape[2] = {rows, columns};
  return nb::ndarray<nb::numpy, double>(owned, columns > 0 ? 2 : 1, shape, owner).cast();
}

nb::object matrix(const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>& m) {
  return array_of(m.data(), 3, 3);
}

Matches matches_of(const Bearings& b1, const Bearings& b2, const double* weights) {
  if (b1.shape(0) != b2.shape(0)) throw nb::value_error("both views must have the same length");
  if (b1.shape(0) < 8) throw nb::value_error("at least eight matches are needed");
  return make_matches(b1.data(), b2.data(), b1.shape(0), weights);
}

[[noreturn]] void refuse(const char* what, const std::string& name) {
  throw nb::value_error(("unknown " + std::string(what) + " " + name).c_str());
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
  PaperPose result;
  {
    nb::gil_scoped_release unlocked;
    result = paper_pose(matches_of(b1, b2, nullptr), method, search, chart);
  }
  return nb::make_tuple(matrix(result.pose.R), array_of(result.pose.t.data(), 3, 0), result.S,
                        result.K, result.cost, result.num_evaluations, result.num_iterations,
                        result.converged);
}

nb::tuple solve_linear_binding(const Bearings& b1, const Bearings& b2, const std::string& name,
                               bool taubin, double S, double K, std::optional<Weights> weights) {
  if (weights && weights->shape(0) != b1.shape(0)) {
    throw nb::value_error("weights and bearings must have the same length");
  }
  const Normalization normalization = normalization_named(name);
  const Constraint constraint = taubin ? Constraint::kTaubin : Constraint::kUnit;
  LinearSolution solution;
  {
    nb::gil_scoped_release unlocked;
    const Matches m = matches_of(b1, b2, weights ? weights->data() : nullptr);
    solution = solve_linear(m, normalization, constraint, S, K);
  }
  return nb::make_tuple(matrix(solution.E), matrix(solution.N1), matrix(solution.N2));
}

nb::tuple search_sk_binding(const Bearings& b1, const Bearings& b2, const std::string& sk_search,
                            std::optional<Weights> weights) {
  if (weights && weights->shape(0) != b1.shape(0)) {
    throw nb::value_error("weights and bearings must have the same length");
  }
  const SkSearch search = search_named(sk_search);
  SkResult result;
  {
    nb::gil_scoped_release unlocked;
    const Matches m = matches_of(b1, b2, weights ? weights->data() : nullptr);
    SkCost cost(m);
    result = epi360::search_sk(cost, search);
  }
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
