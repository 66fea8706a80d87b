// SPDX-License-Identifier: BSD-3-Clause
#include "core/adjustment/window.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/adjustment/normal_equations.h"
#include "core/pose.h"

namespace epi360 {
namespace {

constexpr double kFirstDamping = 1e-4, kLeastDamping = 1e-9, kMostDamping = 1e8;

using RowMatrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

// A long chain of products would drift away from orthonormality.
void straighten(Window& w) {
  for (std::size_t f = 0; f < w.num_frames(); ++f) {
    if (!w.free_frame[f]) continue;
    Eigen::Map<RowMatrix3> R(w.rotations.data() + 9 * f);
    R = Eigen::Quaterniond(Eigen::Matrix3d(R)).normalized().toRotationMatrix();
  }
}

void move_poses(const Window& w, WindowWorkspace& s) {
  s.trial_rotations = w.rotations;
  s.trial_translations = w.translations;
  for (std::size_t f = 0; f < w.num_frames(); ++f) {
    if (s.slot[f] == kNoSlot) continue;
    const Eigen::Map<const Eigen::Matrix<double, 6, 1>> step(s.pose_steps.data() + 6 * s.slot[f]);
    const Eigen::Matrix3d turn = exp_so3(step.head<3>());
    Eigen::Map<RowMatrix3> R(s.trial_rotations.data() + 9 * f);
    Eigen::Map<Eigen::Vector3d> t(s.trial_translations.data() + 3 * f);
    R = (turn * R).eval();
    t = turn * t + step.tail<3>();
  }
}

}  // namespace

WindowReport adjust(Window& w, const WindowOptions& options, WindowWorkspace& s) {
  straighten(w);
  lay_out(w, options, s);
  s.trial_points = w.points;
  WindowReport report;
  report.cost = window_cost(w, options, w.rotations.data(), w.translations.data(), w.points.data());
  double damping = kFirstDamping;
  while (report.num_iterations < options.max_iterations && !report.converged) {
    ++report.num_iterations;
    linearise(w, options, s);
    double decrease = 0.0;
    while (!(decrease > 0.0) && damping < kMostDamping) {
      double cost = std::numeric_limits<double>::infinity();
      if (solve_damped(w, options, damping, s)) {
        move_poses(w, s);
        cost = window_cost(w, options, s.trial_rotations.data(), s.trial_translations.data(),
                           s.trial_points.data());
      }
      if (cost < report.cost) {  // false for NaN
        decrease = report.cost - cost;
        report.cost = cost;
        std::swap(w.rotations, s.trial_rotations);
        std::swap(w.translations, s.trial_translations);
        std::swap(w.points, s.trial_points);
        damping = std::max(0.1 * damping, kLeastDamping);
      } else {
        damping *= 10.0;
      }
    }
    // Without a step that lowers the cost it is a minimum to working precision.
    report.converged = !(decrease > options.tolerance * report.cost);
  }
  return report;
}

}  // namespace epi360
