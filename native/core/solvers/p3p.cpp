// SPDX-License-Identifier: BSD-3-Clause
#include "core/solvers/p3p.h"

#include <Eigen/Geometry>
#include <cmath>

#include "core/solvers/dense.h"
#include "core/solvers/polynomial.h"
#include "core/solvers/svd3.h"

namespace epi360 {
namespace {

constexpr int kPolishingSteps = 4;
constexpr int kCorners[3][2] = {{0, 1}, {0, 2}, {1, 2}};  // of each side

// By the cosine theorem, distances d give side k the squared length d^T form[k] d.
struct Triangle {
  Eigen::Matrix3d form[3];
  double square[3];  // of the sides; their sum is one
};

// Newton's method on the cosine theorems; whether it ends at positive distances.
bool polish(const Triangle& T, Eigen::Vector3d* d) {
  for (int step = 0; step < kPolishingSteps; ++step) {
    Eigen::Vector3d error, slope[3];
    for (int k = 0; k < 3; ++k) {
      slope[k] = 2.0 * (T.form[k] * *d);
      error[k] = 0.5 * slope[k].dot(*d) - T.square[k];
    }
    const Eigen::Vector3d across = slope[1].cross(slope[2]);
    const double det = slope[0].dot(across);
    if (!(std::abs(det) > 0.0)) break;  // two solutions in one
    *d -= (error[0] * across + error[1] * slope[2].cross(slope[0]) +
           error[2] * slope[0].cross(slope[1])) /
          det;
  }
  return d->minCoeff() > 0.0 && std::isfinite(d->sum());
}

Eigen::Matrix3d frame_of(const Eigen::Matrix3d& corners) {
  const Eigen::Vector3d side = corners.col(1) - corners.col(0);
  Eigen::Matrix3d frame;
  frame.col(0) = side.normalized();
  frame.col(2) = side.cross(corners.col(2) - corners.col(0)).normalized();
  frame.col(1) = frame.col(2).cross(frame.col(0));
  return frame;
}

// The two lines (normals, as planes through zero) in which a combination of two conics falls apart:
// the one whose parameter is determined best. False if they are not real. The conic that is not
// nearly the combination goes to `other`.
bool split(const Eigen::Matrix3d& first, const Eigen::Matrix3d& second, SmallMatrix* lines,
           Eigen::Matrix3d* other) {
  const Eigen::Matrix3d adjoint1 = cofactors(first), adjoint2 = cofactors(second);
  double cubic[4] = {adjoint1.row(0).dot(first.row(0)), adjoint1.cwiseProduct(second).sum(),
                     adjoint2.cwiseProduct(first).sum(), adjoint2.row(0).dot(second.row(0))};
  const bool swapped = std::abs(cubic[3]) < std::abs(cubic[0]);  // no root at infinity
  if (swapped) {
    std::swap(cubic[0], cubic[3]);
    std::swap(cubic[1], cubic[2]);
  }
  double roots[3], root = 0.0, steepest = -1.0;
  const int count = real_roots(cubic, 3, roots);
  for (int k = 0; k < count; ++k) {
    const double x = roots[k];
    const double slope = std::abs((3.0 * cubic[3] * x + 2.0 * cubic[2]) * x + cubic[1]);
    if (slope <= steepest) continue;
    root = x;
    steepest = slope;
  }
  if (count == 0) return false;
  const Eigen::Matrix3d& base = swapped ? second : first;
  const Eigen::Matrix3d& added = swapped ? first : second;
  *other = std::abs(root) < 1.0 ? added : base;
  const SmallMatrix A = base + root * added;
  const SmallMatrix E = symmetric_eigenvectors(A);
  const double least = E.col(0).dot(A * E.col(0)), most = E.col(2).dot(A * E.col(2));
  if (!(least < 0.0 && most > 0.0)) return false;
  lines->resize(3, 3);
  lines->col(0) = std::sqrt(most) * E.col(2) + std::sqrt(-least) * E.col(0);
  lines->col(1) = std::sqrt(most) * E.col(2) - std::sqrt(-least) * E.col(0);
  lines->col(2) = E.col(1);  // lies in both
  return true;
}

}  // namespace

int p3p(const Eigen::Matrix3d& bearings, const Eigen::Matrix3d& points, AbsolutePose* poses) {
  Triangle T;
  double scale = 0.0;
  for (int k = 0; k < 3; ++k) {
    const int i = kCorners[k][0], j = kCorners[k][1];
    T.square[k] = (points.col(i) - points.col(j)).squaredNorm();
    T.form[k].setZero();
    T.form[k](i, i) = T.form[k](j, j) = 1.0;
    T.form[k](i, j) = T.form[k](j, i) = -bearings.col(i).dot(bearings.col(j));
    scale += T.square[k];
  }
  const double area = (points.col(1) - points.col(0)).cross(points.col(2) - points.col(0)).norm();
  if (!(area > 1e-9 * scale)) return 0;  // on a line
  for (double& square : T.square) square /= scale;
  // Two conics in the ratios of the distances, which meet where all sides are right.
  const Eigen::Matrix3d first = T.square[2] * T.form[0] - T.square[0] * T.form[2];
  const Eigen::Matrix3d second = T.square[1] * T.form[2] - T.square[2] * T.form[1];
  Eigen::Matrix3d conic;
  SmallMatrix lines;
  if (!split(first, second, &lines, &conic)) return 0;
  const Eigen::Matrix3d total = T.form[0] + T.form[1] + T.form[2];
  const Eigen::Vector3d shared = lines.col(2);
  int count = 0;
  for (int line = 0; line < 2; ++line) {
    const Eigen::Vector3d along = Eigen::Vector3d(lines.col(line)).normalized().cross(shared);
    const double a = shared.dot(conic * shared), b = shared.dot(conic * along),
                 c = along.dot(conic * along), discriminant = b * b - a * c;
    if (!(discriminant >= 0.0)) continue;
    const double q = -(b + std::copysign(std::sqrt(discriminant), b));
    for (int root = 0; root < 2; ++root) {
      Eigen::Vector3d d = root == 0 ? Eigen::Vector3d(q * shared + a * along)
                                    : Eigen::Vector3d(c * shared + q * along);
      d /= std::copysign(std::sqrt(d.dot(total * d)), d.sum());
      if (!(d.minCoeff() > 0.0) || !polish(T, &d)) continue;
      const Eigen::Matrix3d corners = bearings * (std::sqrt(scale) * d).asDiagonal();
      poses[count].R = frame_of(corners) * frame_of(points).transpose();
      poses[count].t = corners.col(0) - poses[count].R * points.col(0);
      ++count;
    }
  }
  return count;
}

}  // namespace epi360
