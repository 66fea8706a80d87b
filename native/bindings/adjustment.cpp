// SPDX-License-Identifier: BSD-3-Clause
// Poses and points of sequences: arrays in, arrays out.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>

#include <tuple>
#include <utility>

#include "bindings/arrays.h"
#include "core/adjustment/absolute_pose.h"
#include "core/adjustment/window.h"

using namespace nanobind::literals;

namespace epi360 {

namespace {

using Rotations = nb::ndarray<const double, nb::shape<-1, 3, 3>, nb::c_contig, nb::device::cpu>;
using Indices = nb::ndarray<const std::uint32_t, nb::shape<-1>, nb::c_contig, nb::device::cpu>;
using Mask = nb::ndarray<const bool, nb::shape<-1>, nb::c_contig, nb::device::cpu>;

template <typename Array>
auto numbers(const Array& array) {
  return std::vector<std::remove_const_t<typename Array::Scalar>>(array.data(),
                                                                  array.data() + array.size());
}

nb::tuple adjust_binding(Rotations rotations, Bearings translations, Bearings points,
                         Mask free_frames, Indices frames, Indices tracks, Bearings bearings,
                         Weights weights, Bearings gravity, Weights gravity_weights,
                         Vector3 world_gravity, double noise, const std::string& loss, double scale,
                         int max_iterations, double tolerance, bool points_free) {
  Window w;
  w.rotations = numbers(rotations);
  w.translations = numbers(translations);
  w.points = numbers(points);
  w.free_frame.assign(free_frames.data(), free_frames.data() + free_frames.size());
  w.frame = numbers(frames);
  w.point = numbers(tracks);
  w.bearings = numbers(bearings);
  w.weights = numbers(weights);
  w.gravity = numbers(gravity);
  w.gravity_weights = numbers(gravity_weights);
  for (std::size_t k = 0; k < 3; ++k) w.world_gravity[k] = world_gravity(k);
  WindowOptions options;
  options.loss.loss = loss_named(loss);
  options.loss.scale = scale;
  options.noise = noise;
  options.max_iterations = max_iterations;
  options.tolerance = tolerance;
  options.points_free = points_free;
  WindowWorkspace workspace;
  const WindowReport report = unlocked([&] { return adjust(w, options, workspace); });
  return nb::make_tuple(taken(std::move(w.rotations)), taken(std::move(w.translations)),
                        taken(std::move(w.points)), report.cost, report.num_iterations,
                        report.converged);
}

nb::object absolute_pose_binding(Bearings bearings, Bearings points,
                                 std::optional<std::tuple<Matrix3, Vector3>> guess,
                                 std::optional<Vector3> gravity, Vector3 world_gravity,
                                 double gravity_sigma, double threshold, std::size_t min_inliers,
                                 std::uint64_t seed) {
  const auto direction = [](const Vector3& v) { return Eigen::Vector3d(v(0), v(1), v(2)); };
  AbsolutePoseOptions options;
  options.threshold = threshold;
  options.min_num_inliers = min_inliers;
  options.seed = seed;
  options.gravity_sigma = gravity_sigma;
  options.world_gravity = direction(world_gravity);
  options.has_gravity = gravity.has_value();
  if (gravity) options.gravity = direction(*gravity);
  std::optional<AbsolutePose> start;
  if (guess) start = {to_matrix(std::get<0>(*guess)), direction(std::get<1>(*guess))};
  const std::optional<AbsolutePose> pose = unlocked([&] {
    return absolute_pose(bearings.data(), points.data(), bearings.shape(0), start, options);
  });
  return pose ? nb::object(nb::make_tuple(matrix(pose->R), vector(pose->t))) : nb::none();
}

nb::list p3p_binding(Matrix3 bearings, Matrix3 points) {
  AbsolutePose poses[4];
  const int count = p3p(to_matrix(bearings).transpose(), to_matrix(points).transpose(), poses);
  nb::list out;
  for (int k = 0; k < count; ++k) out.append(nb::make_tuple(matrix(poses[k].R), vector(poses[k].t)));
  return out;
}

}  // namespace

void bind_adjustment(nb::module_& m) {
  m.def("adjust_window", &adjust_binding, "rotations"_a, "translations"_a, "points"_a,
        "free_frames"_a, "frame_index"_a, "point_index"_a, "bearings"_a, "weights"_a, nb::kw_only(),
        "gravity"_a, "gravity_weights"_a, "world_gravity"_a, "noise"_a, "loss"_a, "loss_scale"_a,
        "max_iterations"_a, "tolerance"_a, "points_free"_a);
  m.def("absolute_pose", &absolute_pose_binding, "bearings"_a, "points"_a, nb::kw_only(),
        "guess"_a.none(), "gravity"_a.none(), "world_gravity"_a, "gravity_sigma"_a, "threshold"_a,
        "min_inliers"_a, "seed"_a);
  m.def("p3p", &p3p_binding, "bearings"_a, "points"_a);
}

}  // namespace epi360
