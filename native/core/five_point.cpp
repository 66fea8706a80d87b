// SPDX-License-Identifier: BSD-3-Clause
#include "five_point.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/QR>
#include <cmath>

#include "polynomial.h"

namespace epi360 {
namespace {

// Polynomials in (x, y, z), coefficients in these orders of monomials:
//   degree 1: x y z 1
//   degree 2: x^2 xy xz y^2 yz z^2 x y z 1
//   degree 3: x^3 y^3 x^2y xy^2 x^2z x^2 y^2z y^2 xyz xy | xz^2 xz x yz^2 yz y z^3 z^2 z 1
using Linear = Eigen::Matrix<double, 1, 4>;
using Quadratic = Eigen::Matrix<double, 1, 10>;
using Cubic = Eigen::Matrix<double, 1, 20>;

Quadratic multiply(const Linear& a, const Linear& b) {
  Quadratic p;
  p << a[0] * b[0], a[0] * b[1] + a[1] * b[0], a[0] * b[2] + a[2] * b[0], a[1] * b[1],
      a[1] * b[2] + a[2] * b[1], a[2] * b[2], a[0] * b[3] + a[3] * b[0], a[1] * b[3] + a[3] * b[1],
      a[2] * b[3] + a[3] * b[2], a[3] * b[3];
  return p;
}

void multiply_add(const Quadratic& q, const Linear& l, double sign, Cubic& p) {
  static constexpr int kIndex[4][10] = {{0, 2, 4, 3, 8, 10, 5, 9, 11, 12},
                                        {2, 3, 8, 1, 6, 13, 9, 7, 14, 15},
                                        {4, 8, 10, 6, 13, 16, 11, 14, 17, 18},
                                        {5, 9, 11, 7, 14, 17, 12, 15, 18, 19}};
  for (int j = 0; j < 4; ++j) {
    const double factor = sign * l[j];
    for (int i = 0; i < 10; ++i) p[kIndex[j][i]] += q[i] * factor;
  }
}

// The ten cubic constraints det E = 0 and 2 E E^T E - tr(E E^T) E = 0.
Eigen::Matrix<double, 10, 20> constraints(const Linear (&e)[3][3]) {
  Quadratic g[3][3];  // E E^T - tr(E E^T) / 2 I
  for (int i = 0; i < 3; ++i) {
    for (int j = i; j < 3; ++j) {
      g[i][j] =
          multiply(e[i][0], e[j][0]) + multiply(e[i][1], e[j][1]) + multiply(e[i][2], e[j][2]);
      g[j][i] = g[i][j];
    }
  }
  const Quadratic half_trace = 0.5 * (g[0][0] + g[1][1] + g[2][2]);
  for (int i = 0; i < 3; ++i) g[i][i] -= half_trace;

  Eigen::Matrix<double, 10, 20> m;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      Cubic row = Cubic::Zero();
      for (int k = 0; k < 3; ++k) multiply_add(g[i][k], e[k][j], 1.0, row);
      m.row(3 * i + j) = row;
    }
  }
  Cubic det = Cubic::Zero();
  for (int j = 0; j < 3; ++j) {
    const int a = (j + 1) % 3, b = (j + 2) % 3;
    const Quadratic minor = multiply(e[1][a], e[2][b]) - multiply(e[1][b], e[2][a]);
    multiply_add(minor, e[0][j], 1.0, det);
  }
  m.row(9) = det;
  return m;
}

// out += sign * a * b for polynomials in z (ascending).
void accumulate_product(const double* a, int da, const double* b, int db, double sign,
                        double* out) {
  for (int i = 0; i <= da; ++i) {
    for (int j = 0; j <= db; ++j) out[i + j] += sign * a[i] * b[j];
  }
}

// One row of Nistér's matrix B(z): the equation upper - z * lower of the eliminated system as
// (cubic in z) x + (cubic) y + (quartic) = 0.
struct RowOfB {
  double x[4], y[4], one[5];
};

RowOfB subtract(const Eigen::Matrix<double, 1, 10>& upper,
                const Eigen::Matrix<double, 1, 10>& lower) {
  return {{upper[2], upper[1] - lower[2], upper[0] - lower[1], -lower[0]},
          {upper[5], upper[4] - lower[5], upper[3] - lower[4], -lower[3]},
          {upper[9], upper[8] - lower[9], upper[7] - lower[8], upper[6] - lower[7], -lower[6]}};
}

void determinant(const RowOfB (&b)[3], double (&det)[11]) {
  for (double& c : det) c = 0.0;
  for (int i = 0; i < 3; ++i) {  // expand along the last column
    const RowOfB& p = b[(i + 1) % 3];
    const RowOfB& q = b[(i + 2) % 3];
    double minor[7] = {0.0};
    accumulate_product(p.x, 3, q.y, 3, 1.0, minor);
    accumulate_product(p.y, 3, q.x, 3, -1.0, minor);
    accumulate_product(minor, 6, b[i].one, 4, 1.0, det);
  }
}

Eigen::Vector3d evaluate(const RowOfB& b, double z) {
  return {((b.x[3] * z + b.x[2]) * z + b.x[1]) * z + b.x[0],
          ((b.y[3] * z + b.y[2]) * z + b.y[1]) * z + b.y[0],
          (((b.one[4] * z + b.one[3]) * z + b.one[2]) * z + b.one[1]) * z + b.one[0]};
}

// The null vector of B(z), by the best conditioned pair of rows.
Eigen::Vector3d null_vector(const RowOfB (&b)[3], double z) {
  const Eigen::Vector3d r0 = evaluate(b[0], z), r1 = evaluate(b[1], z), r2 = evaluate(b[2], z);
  const Eigen::Vector3d candidates[3] = {r0.cross(r1), r1.cross(r2), r2.cross(r0)};
  int best = 0;
  for (int i = 1; i < 3; ++i) {
    if (candidates[i].squaredNorm() > candidates[best].squaredNorm()) best = i;
  }
  return candidates[best];
}

// Roots of nearly degenerate samples can be spurious: E E^T E = E holds for a true one, with
// ||E||_F = sqrt 2.
bool is_essential(const Eigen::Matrix3d& E) {
  return (E * E.transpose() * E - E).cwiseAbs().maxCoeff() < 1e-5;
}

}  // namespace

int five_point(const Eigen::Matrix<double, 3, 5>& bearings1,
               const Eigen::Matrix<double, 3, 5>& bearings2, Eigen::Matrix3d* essentials) {
  Eigen::Matrix<double, 9, 5> rows;  // columns are b2 (x) b1: row-wise vec(E)
  for (int i = 0; i < 5; ++i) {
    for (int r = 0; r < 3; ++r) rows.block<3, 1>(3 * r, i) = bearings2(r, i) * bearings1.col(i);
  }
  const Eigen::HouseholderQR<Eigen::Matrix<double, 9, 5>> qr(rows);
  Eigen::Matrix<double, 9, 4> basis = Eigen::Matrix<double, 9, 4>::Zero();
  basis.bottomRows<4>().setIdentity();
  basis.applyOnTheLeft(qr.householderQ());

  Linear e[3][3];
  for (int k = 0; k < 9; ++k) e[k / 3][k % 3] = basis.row(k);

  const Eigen::Matrix<double, 10, 20> m = constraints(e);
  const Eigen::Matrix<double, 10, 10> g =
      Eigen::PartialPivLU<Eigen::Matrix<double, 10, 10>>(m.leftCols<10>()).solve(m.rightCols<10>());
  if (!g.bottomRows<6>().allFinite()) return 0;
  const RowOfB b[3] = {subtract(g.row(4), g.row(5)), subtract(g.row(6), g.row(7)),
                       subtract(g.row(8), g.row(9))};
  double det[11], roots[10];
  determinant(b, det);
  const int num_roots = real_roots(det, 10, roots);

  int count = 0;
  for (int i = 0; i < num_roots; ++i) {
    const Eigen::Vector3d v = null_vector(b, roots[i]);
    const Eigen::Vector4d combination(v[0], v[1], roots[i] * v[2], v[2]);
    const Eigen::Matrix<double, 9, 1> flat = basis * combination;
    const double norm = flat.norm();
    if (!(norm > 0.0) || !std::isfinite(norm)) continue;
    const Eigen::Matrix3d E =
        Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(flat.data()) *
        (std::sqrt(2.0) / norm);
    if (is_essential(E)) essentials[count++] = E;
  }
  return count;
}

}  // namespace epi360
