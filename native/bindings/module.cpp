// SPDX-License-Identifier: BSD-3-Clause
// Thin: arrays in, arrays out. Shapes and values are checked in Python, where the messages are.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <optional>
#include <variant>
#include <vector>

#include "core/eight_point.h"
#include "core/five_point.h"
#include "core/pair.h"
#include "core/paper_pose.h"
#include "core/refine.h"
#include "core/robust.h"
#include "core/upright.h"

namespace nb = nanobind;
using namespace nb::literals;
using namespace epi360;

namespace {

using Bearings = nb::ndarray<const double, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Weights = nb::ndarray<const double, nb::shape<-1>, nb::c_contig, nb::device::cpu>;
using Jacobians = nb::ndarray<const double, nb::shape<-1, 3, 2>, nb::c_contig, nb::device::cpu>;
using Matrix3 = nb::ndarray<const double, nb::shape<3, 3>, nb::c_contig, nb::device::cpu>;
using Vector3 = nb::ndarray<const double, nb::shape<3>, nb::c_contig, nb::device::cpu>;

template <typename T>
nb::ndarray<nb::numpy, T> array_of(std::vector<T> values, std::vector<std::size_t> shape) {
  auto* owned = new std::vector<T>(std::move(values));
  nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return nb::ndarray<nb::numpy, T>(owned->data(), shape.size(), shape.data(), owner);
}

template <typename Derived>
std::vector<double> flat(const Eigen::MatrixBase<Derived>& m) {
  std::vector<double> values;
  for (Eigen::Index r = 0; r < m.rows(); ++r) {
    for (Eigen::Index c = 0; c < m.cols(); ++c) values.push_back(m(r, c));
  }
  return values;
}

nb::object matrix(const Eigen::MatrixXd& m) {
  return array_of(flat(m), {static_cast<std::size_t>(m.rows()), static_cast<std::size_t>(m.cols())})
      .cast();
}

nb::object vector(const Eigen::Vector3d& v) { return array_of(flat(v), {3}).cast(); }

Eigen::Matrix3d to_matrix(const Matrix3& m) {
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(m.data());
}

RelativePose to_pose(const Matrix3& R, const Vector3& t) {
  return {to_matrix(R), Eigen::Map<const Eigen::Vector3d>(t.data())};
}

void check_jacobians(Residual residual, const Matches& m) {
  if (residual == Residual::kTangentSampson && !m.has_jacobians() && m.size > 0) {
    throw nb::value_error("tangent_sampson needs the Jacobians of both views");
  }
}

Residual residual_named(const std::string& name) {
  if (name == "paper") return Residual::kPaper;
  if (name == "angular") return Residual::kAngular;
  if (name == "sampson") return Residual::kSampson;
  if (name == "tangent_sampson") return Residual::kTangentSampson;
  throw nb::value_error(("unknown residual " + name).c_str());
}

Loss loss_named(const std::string& name) {
  if (name == "squared") return Loss::kSquared;
  if (name == "huber") return Loss::kHuber;
  if (name == "cauchy") return Loss::kCauchy;
  if (name == "geman_mcclure") return Loss::kGemanMcClure;
  if (name == "mixture") return Loss::kMixture;
  throw nb::value_error(("unknown loss " + name).c_str());
}

Matches matches_of(const Bearings& b1, const Bearings& b2, const std::optional<Weights>& weights,
                   const std::optional<Jacobians>& j1, const std::optional<Jacobians>& j2) {
  const std::size_t n = b1.shape(0);
  if (b2.shape(0) != n || (weights && weights->shape(0) != n) || (j1 && j1->shape(0) != n) ||
      (j2 && j2->shape(0) != n)) {
    throw nb::value_error("all arrays must have the same length");
  }
  return make_matches(b1.data(), b2.data(), b1.shape(0), weights ? weights->data() : nullptr,
                      j1 ? j1->data() : nullptr, j2 ? j2->data() : nullptr);
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
  const Matches m = matches_of(b1, b2, weights, j1, j2);
  RefineOptions options;
  options.residual = residual_named(residual);
  check_jacobians(options.residual, m);
  options.loss.loss = loss_named(loss);
  options.loss.scale = scale;
  options.max_iterations = max_iterations;
  RefineResult result;
  RefineWorkspace workspace;
  std::vector<double> residuals(m.padded), front(m.padded);
  const RelativePose start = to_pose(R, t);
  {
    nb::gil_scoped_release unlocked;
    if (options.loss.loss == Loss::kMixture && !(scale > 0.0)) {
      compute_residuals(m, options.residual, plain(start), 0.0, residuals.data(), front.data());
      std::fill(front.begin(), front.end(), 1.0);
      options.loss = fit_mixture(m, residuals.data(), front.data(), options.loss.outlier_density,
                                 options.smallest_scale);
    }
    result = refine(m, start, options, workspace);
    set_statistics(m, workspace, result);
    compute_residuals(m, options.residual, plain(result.pose), 0.0, residuals.data(), front.data());
  }
  residuals.resize(m.size);
  return nb::make_tuple(
      matrix(result.pose.R), vector(result.pose.t), array_of(std::move(residuals), {m.size}),
      result.cost, matrix(result.information), result.weighted_squares, result.effective_matches,
      result.loss.scale, result.num_iterations, result.converged);
}

// status, rotation, translation, scale, threshold, inlier, residuals, num_iterations, parallax,
// coverage, match_coverage, covariance, alternatives, num_usable, num_distinct, spread,
// spread_of_matches, translation_basis, seconds: in the order of _PairResult in _core.pyi.
nb::tuple pair_tuple(PairResult&& pair) {
  RobustResult& r = pair.robust;
  const std::size_t n = r.inlier.size();
  nb::list alternatives;
  for (const RelativePose& pose : r.alternatives) {
    alternatives.append(nb::make_tuple(matrix(pose.R), vector(pose.t)));
  }
  return nb::make_tuple(
      static_cast<int>(r.status), matrix(r.pose.R), vector(r.pose.t), r.scale, r.threshold,
      array_of(std::move(r.inlier), {n}), array_of(std::move(r.residuals), {n}), r.num_iterations,
      r.parallax, r.coverage, r.match_coverage, matrix(r.covariance), alternatives, pair.num_usable,
      pair.support.num_distinct, pair.support.spread, pair.support.spread_of_matches,
      matrix(tangent_basis(r.pose.t)), pair.seconds);
}

// One view's arrays of each pair; those that nobody gave are empty lists.
struct PairArrays {
  std::vector<Bearings> bearings1, bearings2;
  std::vector<Weights> weights, scores;
  std::vector<Jacobians> jacobians1, jacobians2;
  std::vector<Vector3> gravity1, gravity2;
};

// One for all pairs, or one for each.
using Seeds = std::variant<std::uint64_t, std::vector<std::uint64_t>>;

std::uint64_t seed_of(const Seeds& seeds, std::size_t i, std::size_t n) {
  if (const auto* one = std::get_if<std::uint64_t>(&seeds)) return *one;
  const auto& each = std::get<std::vector<std::uint64_t>>(seeds);
  if (each.size() != n) throw nb::value_error("there must be one seed for each pair");
  return each[i];
}

template <typename T>
const double* pointer(const std::vector<T>& arrays, std::size_t i, std::size_t n,
                      std::size_t length) {
  if (arrays.empty()) return nullptr;
  if (arrays.size() != n || (length > 0 && arrays[i].shape(0) != length)) {
    throw nb::value_error("all arrays of a pair must have the same length");
  }
  return arrays[i].data();
}

std::vector<RawPair> raw_pairs(const PairArrays& a, const Seeds& seeds) {
  std::vector<RawPair> pairs(a.bearings1.size());
  const std::size_t n = pairs.size();
  for (std::size_t i = 0; i < n; ++i) {
    const std::size_t length = a.bearings1[i].shape(0);
    pairs[i].n = length;
    pairs[i].bearings1 = a.bearings1[i].data();
    pairs[i].bearings2 = pointer(a.bearings2, i, n, length);
    if (length > 0 && !pairs[i].bearings2) throw nb::value_error("bearings2 is missing");
    pairs[i].weights = pointer(a.weights, i, n, length);
    pairs[i].scores = pointer(a.scores, i, n, length);
    pairs[i].jacobians1 = pointer(a.jacobians1, i, n, length);
    pairs[i].jacobians2 = pointer(a.jacobians2, i, n, length);
    pairs[i].gravity1 = pointer(a.gravity1, i, n, 0);
    pairs[i].gravity2 = pointer(a.gravity2, i, n, 0);
    pairs[i].seed = seed_of(seeds, i, n);
  }
  return pairs;
}

// A list of tuples, or (pair, view, row, is_infinite) of the first bearing that cannot be used.
nb::object estimate_binding(std::vector<Bearings> bearings1, std::vector<Bearings> bearings2,
                            const std::string& residual, double threshold, bool threshold_in_pixels,
                            int sample_size, int min_iterations, int max_iterations,
                            double confidence, const Seeds& seed, int num_threads,
                            std::vector<Weights> weights, std::vector<Weights> scores,
                            std::vector<Jacobians> jacobians1, std::vector<Jacobians> jacobians2,
                            std::vector<Vector3> gravity1, std::vector<Vector3> gravity2) {
  RobustOptions options;
  options.residual = residual_named(residual);
  options.threshold = threshold;
  options.threshold_in_pixels = threshold_in_pixels;
  options.sample_size = sample_size;
  options.min_iterations = min_iterations;
  options.max_iterations = max_iterations;
  options.confidence = confidence;
  const PairArrays arrays{std::move(bearings1), std::move(bearings2),  std::move(weights),
                          std::move(scores),    std::move(jacobians1), std::move(jacobians2),
                          std::move(gravity1),  std::move(gravity2)};
  const std::vector<RawPair> pairs = raw_pairs(arrays, seed);
  if (options.residual == Residual::kTangentSampson && arrays.jacobians1.empty() &&
      !pairs.empty()) {
    throw nb::value_error("tangent_sampson needs the Jacobians of both views");
  }
  std::vector<PairResult> results;
  {
    nb::gil_scoped_release unlocked;
    results = estimate_pairs(pairs, options, num_threads);
  }
  nb::list out;
  for (std::size_t i = 0; i < results.size(); ++i) {
    if (results[i].bad_view) {
      return nb::make_tuple(i, results[i].bad_view, results[i].bad_row, results[i].is_infinite);
    }
    out.append(pair_tuple(std::move(results[i])));
  }
  return out;
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
  for (int k = 0; k < count; ++k)
    out.append(nb::make_tuple(matrix(poses[k].R), vector(poses[k].t)));
  return out;
}

}  // namespace

void bind_paper(nb::module_& m);  // paper.cpp

NB_MODULE(_core, m) {
  bind_paper(m);
  m.def("five_point", &five_point_binding, "bearings1"_a, "bearings2"_a);
  m.def(
      "eight_point",
      [](Bearings b1, Bearings b2, std::optional<Weights> weights) {
        Eigen::Matrix3d E;
        const Matches m = matches_of(b1, b2, weights, {}, {});
        {
          nb::gil_scoped_release unlocked;
          E = eight_point(m);
        }
        return matrix(E);
      },
      "bearings1"_a, "bearings2"_a, "weights"_a.none() = nb::none());
  m.def(
      "pose_from_essential",
      [](Matrix3 E, Bearings b1, Bearings b2) {
        const RelativePose pose = pose_from_essential(matches_of(b1, b2, {}, {}, {}), to_matrix(E));
        return nb::make_tuple(matrix(pose.R), vector(pose.t));
      },
      "E"_a, "bearings1"_a, "bearings2"_a);
  m.def(
      "residuals",
      [](Bearings b1, Bearings b2, Matrix3 R, Vector3 t, const std::string& kind,
         std::optional<Jacobians> j1, std::optional<Jacobians> j2) {
        const Matches matches = matches_of(b1, b2, {}, j1, j2);
        check_jacobians(residual_named(kind), matches);
        const RelativePose pose = to_pose(R, t);
        const Eigen::Matrix<double, 3, 2, Eigen::RowMajor> basis = tangent_basis(pose.t);
        std::vector<double> r(matches.padded), front(matches.padded), J(5 * matches.padded);
        compute_jacobians(matches, residual_named(kind), plain(pose), basis.data(), 0.0, r.data(),
                          front.data(), J.data());
        std::vector<double> rows;
        for (std::size_t i = 0; i < matches.size; ++i) {
          for (std::size_t k = 0; k < 5; ++k) rows.push_back(J[k * matches.padded + i]);
        }
        r.resize(matches.size);
        return nb::make_tuple(array_of(std::move(r), {matches.size}),
                              array_of(std::move(rows), {matches.size, 5}));
      },
      "bearings1"_a, "bearings2"_a, "rotation"_a, "translation"_a, "kind"_a,
      "jacobians1"_a.none() = nb::none(), "jacobians2"_a.none() = nb::none());
  m.def("refine", &refine_binding, "bearings1"_a, "bearings2"_a, "rotation"_a, "translation"_a,
        nb::kw_only(), "residual"_a, "loss"_a, "scale"_a, "weights"_a.none(), "jacobians1"_a.none(),
        "jacobians2"_a.none(), "max_iterations"_a);
  m.def("estimate_relative_poses", &estimate_binding, "bearings1"_a, "bearings2"_a, nb::kw_only(),
        "residual"_a, "threshold"_a, "threshold_in_pixels"_a, "sample_size"_a, "min_iterations"_a,
        "max_iterations"_a, "confidence"_a, "seed"_a, "num_threads"_a, "weights"_a, "scores"_a,
        "jacobians1"_a, "jacobians2"_a, "gravity1"_a, "gravity2"_a);
  m.def("upright_three_point", &upright_binding, "bearings1"_a, "bearings2"_a, "gravity1"_a,
        "gravity2"_a);
}
