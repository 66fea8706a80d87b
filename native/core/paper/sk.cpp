// SPDX-License-Identifier: BSD-3-Clause
#include "core/paper/sk.h"

#include <algorithm>
#include <limits>
#include <vector>

#include "core/paper/residuals.h"
#include "core/solvers/svd3.h"

namespace epi360 {
namespace {

// See the twin for the origin of these numbers.
constexpr double kGrid[] = {-2.5, -1.4, -0.8, -0.25, 0.0, 0.25, 0.8, 2.0};  // of u = ln(K / S)
constexpr int kGridSize = 8;
constexpr int kSteps = 6;
constexpr double kClose = 1e-3;
constexpr double kGolden = 0.3819660112501051;

constexpr double kFirstDamping = 1e-3, kLargestDamping = 1e8;
constexpr int kMaxEvaluations = 100;
constexpr double kDifference = 1e-6;

struct Point {
  double u, value;
};

double golden_section(const Point& left, const Point& middle, const Point& right) {
  if (right.u - middle.u > middle.u - left.u) return middle.u + kGolden * (right.u - middle.u);
  return middle.u - kGolden * (middle.u - left.u);
}

double lowest_of_parabola(const Point& left, const Point& middle, const Point& right) {
  const double p = (middle.u - left.u) * (middle.value - right.value);
  const double q = (middle.u - right.u) * (middle.value - left.value);
  if (p == q) return golden_section(left, middle, right);
  const double tried =
      middle.u - 0.5 * ((middle.u - left.u) * p - (middle.u - right.u) * q) / (p - q);
  const bool useful =
      left.u + kClose < tried && tried < right.u - kClose && std::abs(tried - middle.u) > kClose;
  return useful ? tried : golden_section(left, middle, right);
}

Point narrow(SkCost& cost, Point left, Point middle, Point right) {
  for (int step = 0; step < kSteps; ++step) {
    const double u = lowest_of_parabola(left, middle, right);
    const Point tried{u, cost.at(u)};
    if (tried.value < middle.value) {
      (u > middle.u ? left : right) = middle;
      middle = tried;
    } else {
      (u > middle.u ? right : left) = tried;
    }
  }
  return middle;
}

Point line_search(SkCost& cost) {
  std::vector<Point> points;
  for (const double u : kGrid) points.push_back({u, cost.at(u)});
  int best = 0;
  for (int k = 1; k < kGridSize; ++k) {
    const bool nearer = std::abs(points[k].u) < std::abs(points[best].u);
    const bool lower = points[k].value < points[best].value;
    if (lower || (points[k].value == points[best].value && nearer)) best = k;
  }
  if (best == 0 || best == kGridSize - 1) {
    const double u = 2.0 * points[best].u;
    const Point beyond{u, cost.at(u)};
    if (beyond.value < points[best].value) return beyond;
    points.insert(best == 0 ? points.begin() : points.end(), beyond);
    best += best == 0;
  }
  return narrow(cost, points[best - 1], points[best], points[best + 1]);
}

Eigen::Vector2d forward_differences(SkCost& cost, const Eigen::Vector2d& p, double value) {
  Eigen::Vector2d J;
  for (int k = 0; k < 2; ++k) {
    const double h = kDifference * std::max(std::abs(p[k]), 1.0);
    Eigen::Vector2d moved = p;
    moved[k] += h;
    J[k] = (cost(moved[0], moved[1]) - value) / h;
  }
  return J;
}

// Levenberg-Marquardt from (1, 1) on the one residual that eq. 14 is.
SkResult levenberg_marquardt(SkCost& cost) {
  Eigen::Vector2d p(1.0, 1.0);
  double value = cost(1.0, 1.0);
  Eigen::Vector2d J = forward_differences(cost, p, value);
  double damping = kFirstDamping * J.array().square().maxCoeff();
  while (cost.num_evaluations() < kMaxEvaluations) {
    const double denominator = J.squaredNorm() + damping;
    if (!(denominator > 0.0)) break;  // a zero derivative: already at a minimum
    const Eigen::Vector2d step = -J * (value / denominator);
    if (step.norm() < 1e-8 * (1.0 + p.norm())) break;
    const Eigen::Vector2d candidate = p + step;
    const bool possible = candidate[0] != 0.0 && candidate[1] != 0.0;
    const double tried =
        possible ? cost(candidate[0], candidate[1]) : std::numeric_limits<double>::infinity();
    if (!(tried < value)) {
      damping *= 10.0;
      if (damping > kLargestDamping) break;
      continue;
    }
    const double decrease = (value - tried) / value;
    p = candidate;
    value = tried;
    damping *= 0.1;
    if (decrease < 1e-10 || cost.num_evaluations() + 2 > kMaxEvaluations) break;
    J = forward_differences(cost, p, value);
  }
  return {p[0], p[1], value, cost.num_evaluations()};
}

}  // namespace

SkCost::SkCost(const Matches& m) : m_(m), gram_(gram_matrix(gram_sums(m))) {}

Eigen::Matrix3d SkCost::essential(double S, double K) const {
  const Eigen::Vector3d n(S, S, K);
  const Eigen::Matrix3d N = n.asDiagonal();
  if (m_.size == 8) return scaled(N * rank_two(null_as_matrix(m_, N, N)) * N);
  Eigen::Matrix<double, 9, 1> d;
  for (int k = 0; k < 9; ++k) d[k] = n[k / 3] * n[k % 3];
  return scaled(N * rank_two(smallest_as_matrix(gram_, d)) * N);
}

double SkCost::operator()(double S, double K) {
  ++num_evaluations_;
  const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> E = essential(S, K);
  return absolute_residual_sum(m_, E.data());
}

SkResult search_sk(SkCost& cost, SkSearch search) {
  if (search == SkSearch::kLm) return levenberg_marquardt(cost);
  const Point best = line_search(cost);
  return {1.0, std::exp(best.u), best.value, cost.num_evaluations()};
}

}  // namespace epi360
