// SPDX-License-Identifier: BSD-3-Clause
#include "core/solvers/five_point.h"

#include <algorithm>
#include <cmath>

#include "core/multiversion.h"
#include "core/solvers/polynomial.h"
#include "core/vector3.h"

// Plain arrays, no Eigen: see multiversion.h (measured: 2.2 us a sample where Eigen took 3.7).
namespace epi360 {
namespace {

// Polynomials in (x, y, z), coefficients in these orders of monomials:
//   degree 1: x y z 1
//   degree 2: x^2 xy xz y^2 yz z^2 x y z 1
//   degree 3: x^3 y^3 x^2y xy^2 x^2z x^2 y^2z y^2 xyz xy | xz^2 xz x yz^2 yz y z^3 z^2 z 1
constexpr int kCubic = 20, kEliminated = 10;

// Four vectors that span the E of the five epipolar constraints: the last columns of Q in a
// Householder QR decomposition of the 9 x 5 matrix of columns b2 (x) b1.
EPI360_INLINE void null_space(const double* bearings1, const double* bearings2,
                              double (&basis)[4][9]) {
  double columns[5][9], factor[5];
  for (int i = 0; i < 5; ++i) {
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) {
        columns[i][3 * r + c] = bearings2[3 * i + r] * bearings1[3 * i + c];
      }
    }
  }
  for (int k = 0; k < 5; ++k) {
    double* v = columns[k];  // becomes the reflection's normal
    double squared = 0.0;
    for (int r = k; r < 9; ++r) squared += v[r] * v[r];
    const double norm = std::sqrt(squared);
    const double first = v[k];
    v[k] += first < 0.0 ? -norm : norm;
    const double length = squared - first * first + v[k] * v[k];
    factor[k] = length > 0.0 ? 2.0 / length : 0.0;
    for (int r = 0; r < k; ++r) v[r] = 0.0;
    for (int j = k + 1; j < 5; ++j) {
      double dot = 0.0;
      for (int r = 0; r < 9; ++r) dot += v[r] * columns[j][r];
      dot *= factor[k];
      for (int r = 0; r < 9; ++r) columns[j][r] -= dot * v[r];
    }
  }
  for (int j = 0; j < 4; ++j) {
    for (int r = 0; r < 9; ++r) basis[j][r] = r == 5 + j ? 1.0 : 0.0;
    for (int k = 4; k >= 0; --k) {
      double dot = 0.0;
      for (int r = 0; r < 9; ++r) dot += columns[k][r] * basis[j][r];
      dot *= factor[k];
      for (int r = 0; r < 9; ++r) basis[j][r] -= dot * columns[k][r];
    }
  }
}

// q += sign * a * b of linear polynomials.
EPI360_INLINE void add_product(const double* a, const double* b, double sign, double* q) {
  const double a0 = sign * a[0], a1 = sign * a[1], a2 = sign * a[2], a3 = sign * a[3];
  q[0] += a0 * b[0];
  q[1] += a0 * b[1] + a1 * b[0];
  q[2] += a0 * b[2] + a2 * b[0];
  q[3] += a1 * b[1];
  q[4] += a1 * b[2] + a2 * b[1];
  q[5] += a2 * b[2];
  q[6] += a0 * b[3] + a3 * b[0];
  q[7] += a1 * b[3] + a3 * b[1];
  q[8] += a2 * b[3] + a3 * b[2];
  q[9] += a3 * b[3];
}

// p += q * l of a quadratic and a linear polynomial.
EPI360_INLINE void add_cubic(const double* q, const double* l, double* p) {
  p[0] += q[0] * l[0];
  p[1] += q[3] * l[1];
  p[2] += q[1] * l[0] + q[0] * l[1];
  p[3] += q[3] * l[0] + q[1] * l[1];
  p[4] += q[2] * l[0] + q[0] * l[2];
  p[5] += q[6] * l[0] + q[0] * l[3];
  p[6] += q[4] * l[1] + q[3] * l[2];
  p[7] += q[7] * l[1] + q[3] * l[3];
  p[8] += q[4] * l[0] + q[2] * l[1] + q[1] * l[2];
  p[9] += q[7] * l[0] + q[6] * l[1] + q[1] * l[3];
  p[10] += q[5] * l[0] + q[2] * l[2];
  p[11] += q[8] * l[0] + q[6] * l[2] + q[2] * l[3];
  p[12] += q[9] * l[0] + q[6] * l[3];
  p[13] += q[5] * l[1] + q[4] * l[2];
  p[14] += q[8] * l[1] + q[7] * l[2] + q[4] * l[3];
  p[15] += q[9] * l[1] + q[7] * l[3];
  p[16] += q[5] * l[2];
  p[17] += q[8] * l[2] + q[5] * l[3];
  p[18] += q[9] * l[2] + q[8] * l[3];
  p[19] += q[9] * l[3];
}

// The ten cubic constraints det E = 0 and 2 E E^T E - tr(E E^T) E = 0; e[3 r + c] is entry (r, c).
EPI360_INLINE void constraints(const double (&e)[9][4], double (&m)[10][kCubic]) {
  double g[3][3][10] = {};  // E E^T - tr(E E^T) / 2 I
  for (int i = 0; i < 3; ++i) {
    for (int j = i; j < 3; ++j) {
      for (int k = 0; k < 3; ++k) add_product(e[3 * i + k], e[3 * j + k], 1.0, g[i][j]);
    }
  }
  for (int k = 0; k < 10; ++k) {
    const double half_trace = 0.5 * (g[0][0][k] + g[1][1][k] + g[2][2][k]);
    for (int i = 0; i < 3; ++i) g[i][i][k] -= half_trace;
    g[1][0][k] = g[0][1][k];
    g[2][0][k] = g[0][2][k];
    g[2][1][k] = g[1][2][k];
  }
  for (int i = 0; i < 10; ++i) {
    for (double& coefficient : m[i]) coefficient = 0.0;
  }
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      for (int k = 0; k < 3; ++k) add_cubic(g[i][k], e[3 * k + j], m[3 * i + j]);
    }
  }
  for (int j = 0; j < 3; ++j) {
    const int a = (j + 1) % 3, b = (j + 2) % 3;
    double minor[10] = {};
    add_product(e[3 + a], e[6 + b], 1.0, minor);
    add_product(e[3 + b], e[6 + a], -1.0, minor);
    add_cubic(minor, e[j], m[9]);
  }
}

// Gaussian elimination of the first ten monomials with row pivoting; afterwards row k >= 4 says
// monomial k = -(its last ten entries). False for a singular system.
EPI360_INLINE bool eliminate(double (&m)[10][kCubic]) {
  for (int c = 0; c < kEliminated; ++c) {
    int pivot = c;
    for (int r = c + 1; r < 10; ++r) {
      if (std::abs(m[r][c]) > std::abs(m[pivot][c])) pivot = r;
    }
    if (!(std::abs(m[pivot][c]) > 0.0)) return false;
    if (pivot != c) {
      for (int k = 0; k < kCubic; ++k) std::swap(m[c][k], m[pivot][k]);
    }
    const double inverse = 1.0 / m[c][c];
    for (int k = 0; k < kCubic; ++k) m[c][k] *= inverse;
    for (int r = c + 1; r < 10; ++r) {
      const double factor = m[r][c];
      for (int k = 0; k < kCubic; ++k) m[r][k] -= factor * m[c][k];
    }
  }
  for (int c = 9; c > 4; --c) {
    for (int r = 4; r < c; ++r) {
      const double factor = m[r][c];
      for (int k = kEliminated; k < kCubic; ++k) m[r][k] -= factor * m[c][k];
    }
  }
  return true;
}

// One row of Nistér's matrix B(z): the equation upper - z * lower of the eliminated system as
// (cubic in z) x + (cubic) y + (quartic) = 0.
struct RowOfB {
  double x[4], y[4], one[5];
};

EPI360_INLINE RowOfB subtract(const double* upper, const double* lower) {
  return {{upper[2], upper[1] - lower[2], upper[0] - lower[1], -lower[0]},
          {upper[5], upper[4] - lower[5], upper[3] - lower[4], -lower[3]},
          {upper[9], upper[8] - lower[9], upper[7] - lower[8], upper[6] - lower[7], -lower[6]}};
}

EPI360_INLINE void determinant(const RowOfB (&b)[3], double (&det)[11]) {
  for (double& c : det) c = 0.0;
  for (int i = 0; i < 3; ++i) {  // expand along the last column
    const RowOfB& p = b[(i + 1) % 3];
    const RowOfB& q = b[(i + 2) % 3];
    double minor[7] = {};
    for (int j = 0; j < 4; ++j) {
      for (int k = 0; k < 4; ++k) minor[j + k] += p.x[j] * q.y[k] - p.y[j] * q.x[k];
    }
    for (int j = 0; j < 7; ++j) {
      for (int k = 0; k < 5; ++k) det[j + k] += minor[j] * b[i].one[k];
    }
  }
}

// The null vector of B(z), by the best conditioned pair of rows.
EPI360_INLINE Vec3 null_vector(const RowOfB (&b)[3], double z) {
  Vec3 rows[3];
  for (int i = 0; i < 3; ++i) {
    rows[i] = {evaluate(b[i].x, 3, z), evaluate(b[i].y, 3, z), evaluate(b[i].one, 4, z)};
  }
  Vec3 longest = cross(rows[0], rows[1]);
  for (int i = 1; i < 3; ++i) {
    const Vec3 candidate = cross(rows[i], rows[(i + 1) % 3]);
    if (dot(candidate, candidate) > dot(longest, longest)) longest = candidate;
  }
  return longest;
}

// Roots of nearly degenerate samples can be spurious: E E^T E = E holds for a true one, with
// ||E||_F = sqrt 2.
EPI360_INLINE bool is_essential(const double* E) {
  const Vec3 e[3] = {{E[0], E[1], E[2]}, {E[3], E[4], E[5]}, {E[6], E[7], E[8]}};
  double largest = 0.0;
  for (const Vec3& row : e) {
    const Vec3 d = dot(row, e[0]) * e[0] + dot(row, e[1]) * e[1] + dot(row, e[2]) * e[2] - row;
    largest = std::max({largest, std::abs(d.x), std::abs(d.y), std::abs(d.z)});
  }
  return largest < 1e-5;
}

}  // namespace

EPI360_MULTIVERSION
int five_point(const double* bearings1, const double* bearings2, double* essentials) {
  double basis[4][9], e[9][4], m[10][kCubic];
  null_space(bearings1, bearings2, basis);
  for (int k = 0; k < 9; ++k) {
    for (int j = 0; j < 4; ++j) e[k][j] = basis[j][k];
  }
  constraints(e, m);
  if (!eliminate(m)) return 0;
  const RowOfB b[3] = {subtract(m[4] + 10, m[5] + 10), subtract(m[6] + 10, m[7] + 10),
                       subtract(m[8] + 10, m[9] + 10)};
  double det[11], roots[10];
  determinant(b, det);
  const int num_roots = real_roots(det, 10, roots);

  int count = 0;
  for (int i = 0; i < num_roots; ++i) {
    const Vec3 v = null_vector(b, roots[i]);
    const double combination[4] = {v.x, v.y, roots[i] * v.z, v.z};
    double E[9], squared = 0.0;
    for (int k = 0; k < 9; ++k) {
      E[k] = 0.0;
      for (int j = 0; j < 4; ++j) E[k] += basis[j][k] * combination[j];
      squared += E[k] * E[k];
    }
    const double scale = std::sqrt(2.0 / squared);
    if (!std::isfinite(scale)) continue;
    for (double& entry : E) entry *= scale;
    if (!is_essential(E)) continue;
    std::copy(E, E + 9, essentials + 9 * count);
    ++count;
  }
  return count;
}

}  // namespace epi360
