// SPDX-License-Identifier: BSD-3-Clause
#include "core/paper/gsm.h"

#include <algorithm>
#include <cmath>

#include "core/refinement/refine.h"
#include "core/residuals/residuals.h"
#include "core/solvers/dense.h"

namespace epi360 {
namespace {

constexpr int kMaxIterations = 100;
constexpr double kStepTolerance = 1e-10;

using Basis = Eigen::Matrix<double, 3, 2>;

// Steps w, d: R' = exp([w]x) R, t' = (t + B d) / |.|, B the tangent basis at t.
struct Manifold {
  static constexpr int kSize = 5;
  using Vector = Eigen::Matrix<double, kSize, 1>;
  using Lift = Eigen::Matrix<double, 5, kSize>;

  // Derivative of (w, d) by the step.
  static Lift lift(const RelativePose&, const Basis&) { return Lift::Identity(); }
  static RelativePose moved(const RelativePose& pose, const Basis& basis, const Vector& step) {
    return {exp_so3(step.head<3>()) * pose.R, (pose.t + basis * step.tail<2>()).normalized()};
  }
};

// Steps xi = (w, v) of T' = exp(xi) T on SE(3); the length of t is free and without effect.
struct Se3 {
  static constexpr int kSize = 6;
  using Vector = Eigen::Matrix<double, kSize, 1>;
  using Lift = Eigen::Matrix<double, 5, kSize>;

  // dt = w x t + v: d gets B^T (w x t / |t| + v / |t|).
  static Lift lift(const RelativePose& pose, const Basis& basis) {
    const double length = pose.t.norm();
    Lift lift = Lift::Zero();
    lift.topLeftCorner<3, 3>().setIdentity();
    lift.bottomLeftCorner<2, 3>() = -basis.transpose() * skew(pose.t / length);
    lift.bottomRightCorner<2, 3>() = basis.transpose() / length;
    return lift;
  }
  static RelativePose moved(const RelativePose& pose, const Basis&, const Vector& step) {
    const Eigen::Vector3d w = step.head<3>(), v = step.tail<3>();
    const Eigen::Matrix3d turn = exp_so3(w);
    return {turn * pose.R, turn * pose.t + left_jacobian(w) * v};
  }
  // V of exp(w, v) = (exp w, V v).
  static Eigen::Matrix3d left_jacobian(const Eigen::Vector3d& w) {
    const double squared = w.squaredNorm(), angle = std::sqrt(squared);
    const bool small = angle < 1e-4;  // then the series is exact to working precision
    const double first = small ? 0.5 - squared / 24.0 : (1.0 - std::cos(angle)) / squared;
    const double second =
        small ? 1.0 / 6.0 - squared / 120.0 : (angle - std::sin(angle)) / (squared * angle);
    const Eigen::Matrix3d W = skew(w);
    return Eigen::Matrix3d::Identity() + first * W + second * W * W;
  }
};

PlainPose plain_unit(const RelativePose& pose) { return plain({pose.R, pose.t.normalized()}); }

// Residuals, weights and normal equations at the current pose.
template <typename Chart>
class Linearisation {
 public:
  Linearisation(const Matches& m, std::vector<double>& weights, Weighting reweight)
      : m_(m),
        weights_(weights),
        reweight_(reweight),
        residuals_(m.padded),
        margins_(m.padded),
        jacobian_(5 * m.padded) {}

  // Moves here; returns the cost.
  double move_to(const RelativePose& pose) {
    basis = tangent_basis(pose.t.normalized());
    const Eigen::Matrix<double, 3, 2, Eigen::RowMajor> rows = basis;
    compute_jacobians(m_, Residual::kPaper, plain_unit(pose), rows.data(), residuals_.data(),
                      margins_.data(), jacobian_.data());
    if (reweight_ != Weighting::kNone) {
      residual_weights(m_, residuals_.data(), reweight_, weights_.data());
    }
    double upper[15];
    Vector5 gradient;
    accumulate_normal_equations(m_.padded, jacobian_.data(), residuals_.data(), weights_.data(),
                                upper, gradient.data());
    const typename Chart::Lift lift = Chart::lift(pose, basis);
    hessian_ = lift.transpose() * symmetric(upper) * lift;
    gradient_ = lift.transpose() * gradient;
    return weighted_squares(m_, residuals_.data(), weights_.data());
  }
  // Under the weights of the last move.
  double cost_at(const RelativePose& pose) {
    compute_residuals(m_, Residual::kPaper, plain_unit(pose), residuals_.data(), margins_.data());
    return weighted_squares(m_, residuals_.data(), weights_.data());
  }
  typename Chart::Vector step(double damping) const {
    // The floor matters only where a column of J vanishes: se3 with t along an axis.
    const double least = 1e-12 * hessian_.diagonal().maxCoeff();
    auto damped = hessian_;
    damped.diagonal() += damping * hessian_.diagonal().cwiseMax(least);
    return -solve_symmetric(damped, gradient_);
  }

  Basis basis;  // at the current direction

 private:
  const Matches& m_;
  std::vector<double>& weights_;
  Weighting reweight_;
  std::vector<double> residuals_, margins_, jacobian_;
  Eigen::Matrix<double, Chart::kSize, Chart::kSize> hessian_;
  typename Chart::Vector gradient_;
};

template <typename Chart>
GsmResult minimise(const Matches& m, const RelativePose& start, std::vector<double>& weights,
                   Weighting reweight) {
  Linearisation<Chart> here(m, weights, reweight);
  GsmResult result;
  result.cam2_from_cam1 = start;
  result.cost = here.move_to(start);
  double damping = 1e-4;
  while (result.num_iterations < kMaxIterations && !result.converged) {
    ++result.num_iterations;
    const typename Chart::Vector step = here.step(damping);
    result.converged = !(step.norm() >= kStepTolerance);
    if (result.converged) break;
    const RelativePose candidate = Chart::moved(result.cam2_from_cam1, here.basis, step);
    if (here.cost_at(candidate) < result.cost) {
      result.cam2_from_cam1 = candidate;
      result.cost = here.move_to(candidate);
      damping = std::max(damping * 0.1, 1e-9);
    } else {
      damping *= 10.0;
      result.converged = damping > 1e8;  // no step lowers the cost
    }
  }
  result.cam2_from_cam1.t.normalize();
  return result;
}

}  // namespace

GsmResult gold_standard(const Matches& m, const RelativePose& start, std::vector<double>& weights,
                        Parameterization parameterization, Weighting reweight) {
  return parameterization == Parameterization::kSe3
             ? minimise<Se3>(m, start, weights, reweight)
             : minimise<Manifold>(m, start, weights, reweight);
}

}  // namespace epi360
