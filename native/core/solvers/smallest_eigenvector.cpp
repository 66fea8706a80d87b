// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>
#include <limits>

#include "core/multiversion.h"
#include "core/solvers/gram.h"

namespace epi360 {
namespace {

constexpr int kSize = 9;
constexpr int kRow = 12;  // padded with zeros to whole vectors
constexpr double kEpsilon = std::numeric_limits<double>::epsilon();

// T = H M H^T with H the product of seven reflections I - beta u u^T (Golub & Van Loan, "Matrix
// Computations", section 8.3.1).
struct Tridiagonal {
  double diagonal[kSize], beside[kSize];  // beside[i] couples i and i + 1
  double u[kSize - 2][kRow], beta[kSize - 2];
};

// Rows and columns that are done are zeroed, so that all loops have one fixed length.
EPI360_INLINE void reflect_rows(double (*A)[kRow], const double* u, double beta, int first) {
  double p[kRow] = {}, up = 0.0;
  for (int i = first; i < kSize; ++i) {
    for (int j = 0; j < kRow; ++j) p[j] += u[i] * A[i][j];
  }
  for (int j = 0; j < kRow; ++j) up += u[j] * p[j];
  const double share = 0.5 * beta * up;
  for (int j = 0; j < kRow; ++j) p[j] = beta * (p[j] - share * u[j]);
  for (int i = first; i < kSize; ++i) {
    for (int j = 0; j < kRow; ++j) A[i][j] -= u[i] * p[j] + p[i] * u[j];
  }
}

EPI360_INLINE void tridiagonalise(double (*A)[kRow], Tridiagonal& t) {
  for (int k = 0; k < kSize - 2; ++k) {
    t.diagonal[k] = A[k][k];
    double* u = t.u[k];
    double squared = 0.0;
    for (int i = 0; i < kRow; ++i) u[i] = 0.0;
    for (int i = k + 1; i < kSize; ++i) {
      u[i] = A[i][k];
      squared += u[i] * u[i];
      A[i][k] = 0.0;
    }
    const double norm = std::sqrt(squared), head = u[k + 1];
    const double signed_norm = head < 0.0 ? -norm : norm;
    t.beside[k] = -signed_norm;
    u[k + 1] += signed_norm;
    t.beta[k] = squared > 0.0 ? 1.0 / (squared + std::fabs(head) * norm) : 0.0;
    reflect_rows(A, u, t.beta[k], k + 1);
  }
  t.diagonal[kSize - 2] = A[kSize - 2][kSize - 2];
  t.diagonal[kSize - 1] = A[kSize - 1][kSize - 1];
  t.beside[kSize - 2] = A[kSize - 1][kSize - 2];
}

// Laguerre's step from x to the smallest eigenvalue l_1 > x, which it cannot pass: with
// s1 = sum 1 / (l_i - x) and s2 = sum 1 / (l_i - x)^2 from the pivots of T - x and their
// derivatives. Negative if x is not below l_1.
EPI360_INLINE double laguerre_step(const Tridiagonal& t, double x) {
  double ratio = 0.0, slope = 0.0, curve = 0.0, s1 = 0.0, s2 = 0.0;
  for (int i = 0; i < kSize; ++i) {
    const double pivot = t.diagonal[i] - x - ratio;
    if (!(pivot > 0.0)) return -1.0;
    const double inverse = 1.0 / pivot;
    const double by_x = ratio * slope - 1.0, by_xx = ratio * (curve - slope * slope);
    slope = by_x * inverse;                   // derivative of log(pivot)
    curve = by_xx * inverse - slope * slope;  // second derivative
    s1 -= slope;
    s2 -= curve;
    if (i < kSize - 1) ratio = t.beside[i] * t.beside[i] * inverse;
  }
  const double spread = (kSize - 1) * (kSize * s2 - s1 * s1);
  return kSize / (s1 + std::sqrt(spread > 0.0 ? spread : 0.0));
}

EPI360_INLINE double smallest_eigenvalue(const Tridiagonal& t, double trace) {
  double x = -4.0 * kEpsilon * trace;  // below an eigenvalue of zero and its rounding error
  for (int iteration = 0; iteration < 30; ++iteration) {
    const double step = laguerre_step(t, x);
    if (step < 0.0) break;
    x += step;
    if (step < kEpsilon * trace) break;
  }
  return x;
}

// (T - x) z = gamma e_k with the k of least |gamma|: pivots from both ends meet there (Dhillon &
// Parlett, "Orthogonal eigenvectors and relative gaps", 2003).
EPI360_INLINE void twisted_vector(const Tridiagonal& t, double x, double* z) {
  double down[kSize], up[kSize];
  down[0] = t.diagonal[0] - x;
  up[kSize - 1] = t.diagonal[kSize - 1] - x;
  for (int i = 1; i < kSize; ++i) {
    const int j = kSize - 1 - i;
    down[i] = t.diagonal[i] - x - t.beside[i - 1] * t.beside[i - 1] / down[i - 1];
    up[j] = t.diagonal[j] - x - t.beside[j] * t.beside[j] / up[j + 1];
  }
  int twist = 0;
  double least = std::numeric_limits<double>::infinity();
  for (int i = 0; i < kSize; ++i) {
    const double gamma = std::fabs(down[i] + up[i] - (t.diagonal[i] - x));
    if (gamma < least) {
      least = gamma;
      twist = i;
    }
  }
  z[twist] = 1.0;
  for (int i = twist; i > 0; --i) z[i - 1] = -t.beside[i - 1] * z[i] / down[i - 1];
  for (int i = twist; i < kSize - 1; ++i) z[i + 1] = -t.beside[i] * z[i] / up[i + 1];
}

// |M v - (v^T M v) v|^2 for a unit vector.
EPI360_INLINE double squared_misfit(const double* M, const double* v) {
  double product[kSize], value = 0.0, misfit = 0.0;
  for (int i = 0; i < kSize; ++i) {
    product[i] = 0.0;
    for (int j = 0; j < kSize; ++j) product[i] += M[kSize * i + j] * v[j];
    value += product[i] * v[i];
  }
  for (int i = 0; i < kSize; ++i) {
    const double r = product[i] - value * v[i];
    misfit += r * r;
  }
  return misfit;
}

// z becomes A^-1 z by A = U^T P U, U of unit diagonal (no pivoting: A is all but semidefinite).
// Only the last pivot can vanish; then any tiny number does for inverse iteration.
EPI360_INLINE void solve_symmetric(double (*A)[kRow], double* z) {
  double inverse[kSize];
  for (int k = 0; k < kSize; ++k) {
    inverse[k] = 1.0 / (A[k][k] != 0.0 ? A[k][k] : kEpsilon * A[0][0]);
    for (int i = k + 1; i < kSize; ++i) {
      const double share = A[k][i] * inverse[k];
      for (int j = 0; j < kRow; ++j) A[i][j] -= share * A[k][j];
    }
    const double share = z[k] * inverse[k];
    for (int j = k + 1; j < kSize; ++j) z[j] -= share * A[k][j];
  }
  for (int k = kSize - 1; k >= 0; --k) {
    for (int j = k + 1; j < kSize; ++j) z[k] -= A[k][j] * z[j];
    z[k] *= inverse[k];
  }
}

}  // namespace

EPI360_MULTIVERSION
bool smallest_eigenvector(const double* M, double* v) {
  double A[kSize][kRow] = {}, z[kRow] = {}, trace = 0.0;
  for (int i = 0; i < kSize; ++i) {
    for (int j = 0; j < kSize; ++j) A[i][j] = M[kSize * i + j];
    trace += A[i][i];
  }
  Tridiagonal t;
  tridiagonalise(A, t);
  twisted_vector(t, smallest_eigenvalue(t, trace), z);
  for (int k = kSize - 3; k >= 0; --k) {
    double dot = 0.0;
    for (int j = 0; j < kRow; ++j) dot += t.u[k][j] * z[j];
    for (int j = 0; j < kRow; ++j) z[j] -= t.beta[k] * dot * t.u[k][j];
  }
  double squared = 0.0;
  for (int i = 0; i < kSize; ++i) squared += z[i] * z[i];
  const double inverse = 1.0 / std::sqrt(squared);
  for (int i = 0; i < kSize; ++i) v[i] = z[i] * inverse;
  const double allowed = 16.0 * kEpsilon * trace;
  return squared_misfit(M, v) < allowed * allowed;  // false for NaN
}

EPI360_MULTIVERSION
void polish_scaled_eigenvector(const double* M, const double* d, double* v) {
  // With y = D v: (M - r D^-2) y = 0 at r = y^T M y.
  double A[kSize][kRow] = {}, z[kRow] = {}, value = 0.0;
  for (int i = 0; i < kSize; ++i) {
    double product = 0.0;
    for (int j = 0; j < kSize; ++j) {
      A[i][j] = M[kSize * i + j];
      product += A[i][j] * d[j] * v[j];
    }
    value += d[i] * v[i] * product;
  }
  for (int i = 0; i < kSize; ++i) {
    A[i][i] -= value / (d[i] * d[i]);
    z[i] = v[i] / d[i];
  }
  solve_symmetric(A, z);
  double squared = 0.0;
  for (int i = 0; i < kSize; ++i) {
    z[i] /= d[i];
    squared += z[i] * z[i];
  }
  const double inverse = 1.0 / std::sqrt(squared);
  if (!(inverse > 0.0)) return;  // infinite or not a number
  for (int i = 0; i < kSize; ++i) v[i] = z[i] * inverse;
}

}  // namespace epi360
