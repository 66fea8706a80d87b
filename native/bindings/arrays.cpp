// SPDX-License-Identifier: BSD-3-Clause
#include "bindings/arrays.h"

#include <algorithm>
#include <utility>

namespace epi360 {

nb::object copied(const double* values, std::size_t rows, std::size_t columns) {
  const std::size_t count = rows * (columns > 0 ? columns : 1);
  double* owned = new double[count];
  std::copy(values, values + count, owned);
  nb::capsule owner(owned, [](void* p) noexcept { delete[] static_cast<double*>(p); });
  const std::size_t shape[2] = {rows, columns};
  return nb::ndarray<nb::numpy, double>(owned, columns > 0 ? 2 : 1, shape, owner).cast();
}

nb::object matrix(const Eigen::Matrix3d& m) {
  const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rows = m;
  return copied(rows.data(), 3, 3);
}

nb::object vector(const Eigen::Vector3d& v) { return copied(v.data(), 3, 0); }

nb::object pose_tuple(const RelativePose& pose) {
  return nb::make_tuple(matrix(pose.R), vector(pose.t));
}

nb::object taken(std::vector<double> values) {
  auto* owned = new std::vector<double>(std::move(values));
  nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<double>*>(p); });
  const std::size_t shape[1] = {owned->size()};
  return nb::ndarray<nb::numpy, double>(owned->data(), 1, shape, owner).cast();
}

Eigen::Matrix3d to_matrix(const Matrix3& m) {
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(m.data());
}

RelativePose to_pose(const Matrix3& rotation, const Vector3& translation) {
  return {to_matrix(rotation), Eigen::Map<const Eigen::Vector3d>(translation.data())};
}

Matches to_matches(const Bearings& bearings1, const Bearings& bearings2,
                   const std::optional<Weights>& weights,
                   const std::optional<Jacobians>& jacobians1,
                   const std::optional<Jacobians>& jacobians2) {
  const std::size_t n = bearings1.shape(0);
  if (bearings2.shape(0) != n || (weights && weights->shape(0) != n) ||
      (jacobians1 && jacobians1->shape(0) != n) || (jacobians2 && jacobians2->shape(0) != n)) {
    throw nb::value_error("all arrays must have the same length");
  }
  return make_matches(bearings1.data(), bearings2.data(), n, weights ? weights->data() : nullptr,
                      jacobians1 ? jacobians1->data() : nullptr,
                      jacobians2 ? jacobians2->data() : nullptr);
}

void refuse(const char* what, const std::string& name) {
  throw nb::value_error(("unknown " + std::string(what) + " " + name).c_str());
}

Residual residual_named(const std::string& name) {
  if (name == "paper") return Residual::kPaper;
  if (name == "angular") return Residual::kAngular;
  if (name == "sampson") return Residual::kSampson;
  if (name == "tangent_sampson") return Residual::kTangentSampson;
  refuse("residual", name);
}

Loss loss_named(const std::string& name) {
  if (name == "squared") return Loss::kSquared;
  if (name == "huber") return Loss::kHuber;
  if (name == "cauchy") return Loss::kCauchy;
  if (name == "geman_mcclure") return Loss::kGemanMcClure;
  if (name == "mixture") return Loss::kMixture;
  refuse("loss", name);
}

}  // namespace epi360
