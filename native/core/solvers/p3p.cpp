// SPDX-License-Identifier: BSD-3-Clause
#include "core/solvers/p3p.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "core/solvers/dense.h"
#include "core/solvers/polynomial.h"

namespace epi360 {
namespace {

constexpr int kPolishingSteps = 4;
constexpr int kOther[3][2] = {{0, 1}, {0, 2}, {1, 2}};  // the two corners of each side

// Squared sides of the triangle and the cosines of the angles under which they are seen.
struct Triangle {
  double side[3], cosine[3];
};

// Newton's method on the cosine theorem of each side; whether it ends at positive distances.
bool polish(const Triangle& T, Eigen::Vector3d* distances) {
  Eigen::Vector3d& d = *distances;
  for (int step = 0; step < kPolishingSteps; ++step) {
    Eigen::Matrix3d J = Eigen::Matrix3d::Zero();
    Eigen::Vector3d error;
    for (int k = 0; k < 3; ++k) {
      const int i = kOther[k][0], j = kOther[k][1];
      error[k] = d[i] * d[i] + d[j] * d[j] - 2.0 * T.cosine[k] * d[i] * d[j] - T.side[k];
      J(k, i) = 2.0 * (d[i] - T.cosine[k] * d[j]);
      J(k, j) = 2.0 * (d[j] - T.cosine[k] * d[i]);
    }
    const Eigen::Vector3d a = J.row(0), b = J.row(1), c = J.row(2);
    const Eigen::Vector3d bc = b.cross(c), ca = c.cross(a), ab = a.cross(b);
    const double det = a.dot(bc);
    if (!(std::abs(det) > 0.0)) break;  // a double solution
    d -= (error[0] * bc + error[1] * ca + error[2] * ab) / det;
  }
  return d.minCoeff() > 0.0 && std::isfinite(d.sum());
}

Eigen::Matrix3d frame_of(const Eigen::Matrix3d& corners) {
  const Eigen::Vector3d side = corners.col(1) - corners.col(0);
  Eigen::Matrix3d frame;
  frame.col(0) = side.normalized();
  frame.col(2) = side.cross(corners.col(2) - corners.col(0)).normalized();
  frame.col(1) = frame.col(2).cross(frame.col(0));
  return frame;
}

// The distances form d^T D1 d = d^T D2 d = 0. Root of det(D1 + root D2) that is best determined.
bool degenerate_root(const Triangle& T, double* root) {
  const double a = T.side[0], b = T.side[1], c = T.side[2];  // 12, 13, 23
  const double *cosine = T.cosine, s12 = 1.0 - cosine[0] * cosine[0],
               s13 = 1.0 - cosine[1] * cosine[1], s23 = 1.0 - cosine[2] * cosine[2];
  const double blob = cosine[0] * cosine[1] * cosine[2] - 1.0;
  const double cubic[4] = {a * (a * s23 - c * s12),
                           c * (b - c) * s12 - a * a * s23 - 2.0 * a * (blob * c + b * s23),
                           2.0 * blob * c * b + b * (2.0 * a + b) * s23 + c * (c - a) * s13,
                           b * (c * s13 - b * s23)};
  double roots[3], steepest = -1.0;
  const int count = real_roots(cubic, 3, roots);
  for (int k = 0; k < count; ++k) {
    const double x = roots[k];
    const double slope = std::abs((3.0 * cubic[3] * x + 2.0 * cubic[2]) * x + cubic[1]);
    if (slope > steepest) *root = x;
    steepest = std::max(steepest, slope);
  }
  return count > 0;
}

}  // namespace

int p3p(const Eigen::Matrix3d& bearings, const Eigen::Matrix3d& points, AbsolutePose* poses) {
  Triangle T;
  for (int k = 0; k < 3; ++k) {
    const int i = kOther[k][0], j = kOther[k][1];
    T.side[k] = (points.col(i) - points.col(j)).squaredNorm();
    T.cosine[k] = bearings.col(i).dot(bearings.col(j));
  }
  const double scale = T.side[0] + T.side[1] + T.side[2];
  const double area = (points.col(1) - points.col(0)).cross(points.col(2) - points.col(0)).norm();
  if (!(area > 1e-9 * scale)) return 0;  // on a line
  for (double& side : T.side) side /= scale;
  const double a12 = T.side[0], a13 = T.side[1], a23 = T.side[2];
  const double b12 = -2.0 * T.cosine[0], b13 = -2.0 * T.cosine[1], b23 = -2.0 * T.cosine[2];
  double g = 0.0;
  if (!degenerate_root(T, &g)) return 0;
  SmallMatrix A(3, 3);
  A << a23 * (1.0 - g), 0.5 * a23 * b12, -0.5 * a23 * b13 * g,  //
      0.5 * a23 * b12, a23 - a12 + a13 * g, 0.5 * b23 * (a13 * g - a12),
      -0.5 * a23 * b13 * g, 0.5 * b23 * (a13 * g - a12), g * (a13 - a23) - a12;
  // One eigenvalue is zero and the others have opposite signs: a pair of planes through zero.
  const SmallMatrix E = symmetric_eigenvectors(A);
  const double least = E.col(0).dot(A * E.col(0)), most = E.col(2).dot(A * E.col(2));
  if (!(least < 0.0 && most > 0.0)) return 0;
  int count = 0;
  for (const double sign : {1.0, -1.0}) {
    // d lies in the plane across n: d0 = w0 d1 + w1 d2.
    const Eigen::Vector3d n =
        std::sqrt(most) * E.col(2) + sign * std::sqrt(-least) * E.col(0);
    const double w0 = -n[1] / n[0], w1 = -n[2] / n[0];
    const double a = (a13 - a12) * w1 * w1 - a12 * b13 * w1 - a12;
    const double b = a13 * b12 * w1 - a12 * b13 * w0 - 2.0 * w0 * w1 * (a12 - a13);
    const double c = (a13 - a12) * w0 * w0 + a13 * b12 * w0 + a13;
    const double discriminant = b * b - 4.0 * a * c;
    if (!(discriminant >= 0.0)) continue;
    const double q = -0.5 * (b + std::copysign(std::sqrt(discriminant), b));
    for (const double tau : {q / a, c / q}) {  // d2 / d1
      const double square = a23 / (tau * (b23 + tau) + 1.0);
      if (!(tau > 0.0 && square > 0.0) || count == 4) continue;
      Eigen::Vector3d d(0.0, std::sqrt(square), tau * std::sqrt(square));
      d[0] = w0 * d[1] + w1 * d[2];
      if (!(d[0] > 0.0) || !polish(T, &d)) continue;
      const Eigen::Matrix3d corners = bearings * (std::sqrt(scale) * d).asDiagonal();
      poses[count].R = frame_of(corners) * frame_of(points).transpose();
      poses[count].t = corners.col(0) - poses[count].R * points.col(0);
      ++count;
    }
  }
  return count;
}

}  // namespace epi360
