// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/plane.h"
#include "core/bearings.h"
#include "core/solvers/dense.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace epi360 {
namespace {

constexpr int kFewRounds = 5;  // of twelve: those before a gate of four times the final one

// Along the epipolar plane, b2 is off by (|b2 x t| (n . b1) + u . (b2 x a)) / |a + t (n . b1)| for
// a point of the plane, with a = R b1 and u = b2 x t / |b2 x t|: linear in n but for the length.
struct PlaneTerm {
  Eigen::Vector3d b1, a;
  double lever, constant;
};

PlaneTerm plane_term(const RelativePose& pose, const Eigen::Vector3d& b1,
                     const Eigen::Vector3d& b2) {
  const Eigen::Vector3d a = pose.R * b1;
  const Eigen::Vector3d bt = b2.cross(pose.t);
  const double lever = std::max(bt.norm(), 1e-12);
  return {b1, a, lever, bt.dot(b2.cross(a)) / lever};
}

// About a hundred of the chosen matches tell whether there may be a plane at all.
std::vector<PlaneTerm> plane_terms(const Matches& m, const RelativePose& pose,
                                   const std::vector<unsigned char>& chosen, bool all) {
  const auto count = std::count(chosen.begin(), chosen.end(), 1);
  const auto stride = all ? 1 : std::max<std::ptrdiff_t>(count / 100, 1);
  std::vector<PlaneTerm> terms;
  terms.reserve(static_cast<std::size_t>(count / stride + 1));
  std::ptrdiff_t seen = 0;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!chosen[i] || seen++ % stride != 0) continue;
    terms.push_back(plane_term(pose, view1(m, i), view2(m, i)));
  }
  return terms;
}

}  // namespace

Eigen::Vector3d fit_plane(const Matches& m, const RelativePose& pose,
                          const std::vector<unsigned char>& chosen, double gate, double* share) {
  Eigen::Vector3d n = Eigen::Vector3d::Zero();
  double total = 0.0, inside = 0.0;
  std::vector<PlaneTerm> terms = plane_terms(m, pose, chosen, false);
  for (int round = 0; round < 12; ++round) {  // Cauchy weights, narrowing to the gate
    if (round == kFewRounds) terms = plane_terms(m, pose, chosen, true);
    const double scale = gate * std::max(1.0, std::exp2(6 - round));
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    total = inside = 0.0;
    double near = 0.0;
    for (const PlaneTerm& term : terms) {
      const double along = n.dot(term.b1), length = (term.a + pose.t * along).norm();
      const double error = (term.lever * along + term.constant) / length;
      const double weight = 1.0 / ((1.0 + error * error / (scale * scale)) * length * length);
      normal += weight * term.lever * term.lever * term.b1 * term.b1.transpose();
      right -= weight * term.lever * term.constant * term.b1;
      total += 1.0;
      inside += std::abs(error) < gate;
      near += std::abs(error) < scale;
    }
    if (round == kFewRounds - 1 && near < 0.5 * total) break;  // at 4 gates: no plane
    normal.diagonal().array() += 1e-12 * (1.0 + normal.trace());
    n = solve_symmetric(normal, right);
  }
  *share = total > 0.0 ? inside / total : 0.0;
  return n;
}

bool twin_pose(const RelativePose& pose, const Eigen::Vector3d& n, RelativePose* twin) {
  Eigen::Matrix3d H = pose.R + pose.t * n.transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> first(H.transpose() * H);
  if (!(first.eigenvalues()[1] > 1e-12)) return false;
  H /= std::sqrt(first.eigenvalues()[1]);
  const Eigen::Vector3d squares = first.eigenvalues() / first.eigenvalues()[1];
  const double gap = squares[2] - squares[0];
  if (!(gap > 1e-9)) return false;  // no translation: the homography is the rotation
  const Eigen::Vector3d v1 = first.eigenvectors().col(2), v2 = first.eigenvectors().col(1),
                        v3 = first.eigenvectors().col(0);
  const double along = std::sqrt(std::max(1.0 - squares[0], 0.0) / gap);
  const double across = std::sqrt(std::max(squares[2] - 1.0, 0.0) / gap);
  double largest = -1.0;
  for (const double sign : {1.0, -1.0}) {
    const Eigen::Vector3d u = along * v1 + sign * across * v3;
    Eigen::Matrix3d U, W;
    U << v2, u, v2.cross(u);
    W << H * v2, H * u, (H * v2).cross(H * u);
    RelativePose candidate;
    candidate.R = Eigen::Quaterniond(Eigen::Matrix3d(W * U.transpose())).normalized();
    Eigen::Vector3d normal = U.col(2);
    candidate.t = (H - candidate.R) * normal;
    if (candidate.t.norm() < 1e-9) continue;
    // (t, n) and (-t, -n) are one homography; the plane lies on the same side as before.
    if (normal.dot(n) < 0.0) candidate.t = -candidate.t;
    candidate.t.normalize();
    const double away = rotation_angle(candidate.R, pose.R) + direction_angle(candidate.t, pose.t);
    if (away <= largest) continue;
    largest = away;
    *twin = candidate;
  }
  return largest > 1e-3;
}

}  // namespace epi360
