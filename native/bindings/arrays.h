// SPDX-License-Identifier: BSD-3-Clause
// NumPy arrays in and out, and the names of options.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "core/matches.h"
#include "core/pose.h"
#include "core/refinement/loss.h"
#include "core/residuals/residuals.h"

namespace epi360 {

namespace nb = nanobind;

using Bearings = nb::ndarray<const double, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Weights = nb::ndarray<const double, nb::shape<-1>, nb::c_contig, nb::device::cpu>;
using Jacobians = nb::ndarray<const double, nb::shape<-1, 3, 2>, nb::c_contig, nb::device::cpu>;
using Matrix3 = nb::ndarray<const double, nb::shape<3, 3>, nb::c_contig, nb::device::cpu>;
using Vector3 = nb::ndarray<const double, nb::shape<3>, nb::c_contig, nb::device::cpu>;

// A copy of row-major numbers as an array of its own; one-dimensional where columns is 0.
nb::object copied(const double* values, std::size_t rows, std::size_t columns);
nb::object matrix(const Eigen::Matrix3d& m);
nb::object vector(const Eigen::Vector3d& v);
nb::object pose_tuple(const RelativePose& pose);  // (rotation, translation)

// An array that takes the numbers over.
nb::object taken(std::vector<double> values);

Eigen::Matrix3d to_matrix(const Matrix3& m);
RelativePose to_pose(const Matrix3& rotation, const Vector3& translation);
Matches to_matches(const Bearings& bearings1, const Bearings& bearings2,
                   const std::optional<Weights>& weights = {},
                   const std::optional<Jacobians>& jacobians1 = {},
                   const std::optional<Jacobians>& jacobians2 = {});

[[noreturn]] void refuse(const char* what, const std::string& name);
Residual residual_named(const std::string& name);
Loss loss_named(const std::string& name);

// The result of a computation without Python's lock.
template <typename Compute>
auto unlocked(const Compute& compute) {
  nb::gil_scoped_release release;
  return compute();
}

}  // namespace epi360
