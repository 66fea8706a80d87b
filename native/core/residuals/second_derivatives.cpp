// SPDX-License-Identifier: BSD-3-Clause
#include "core/residuals/second_derivatives.h"

#include <algorithm>
#include <cmath>

#include "core/multiversion.h"
#include "core/residuals/denominator.h"
#include "core/vector3.h"

namespace epi360 {
namespace {

constexpr std::size_t kBlock = Matches::kBlock;

// Two unit vectors across a bearing. Which ones does not matter, as all that is made of them is
// summed over both; the first is across the x or the y axis, whichever is not near.
EPI360_INLINE void set_axes(const Vec3& bearing, Vec3* axes) {
  const double x = std::abs(bearing.x) < 0.6 ? 1.0 : 0.0, y = 1.0 - x;
  const Vec3 across{y * bearing.z, -x * bearing.z, x * bearing.y - y * bearing.x};
  axes[0] = 1.0 / std::sqrt(dot(across, across)) * across;
  axes[1] = cross(axes[0], bearing);
}

// Derivatives of one match by each move, by w and by the two components of d; see
// compute_jacobians.
struct Row {
  Vec3 by_w[kMoves];
  double by_d1[kMoves], by_d2[kMoves], squared_jacobian;
};

// The residual is C / g with C = t . (a x b), a = R b1, b = b2, and the gradient g of C by the
// moves (by those of b alone in one-sided residuals). Where C is zero, so that J = C' / g, it is
// dJ = (dC' - C' dg / g - dC g' / g) / g, with a prime for the derivative by the pose:
// C' = a x (b x t) by w and a x b by t.
template <bool has_pixels, bool one_sided>
EPI360_INLINE Row second_derivatives(const Matches& m, const PlainPose& p, const double* B,
                                     std::size_t i) {
  const Vec3 t{p.t[0], p.t[1], p.t[2]};
  const Vec3 a = product(p.R, bearing1(m, i)), b = bearing2(m, i);
  const Vec3 bt = cross(b, t), ta = cross(t, a);
  Vec3 move[kMoves];  // of a, and of b
  if (has_pixels) {
    move[0] = product(p.R, {m.u1x[i], m.u1y[i], m.u1z[i]});
    move[1] = product(p.R, {m.v1x[i], m.v1y[i], m.v1z[i]});
    move[2] = {m.u2x[i], m.u2y[i], m.u2z[i]};
    move[3] = {m.v2x[i], m.v2y[i], m.v2z[i]};
  } else {
    set_axes(a, move);
    set_axes(b, move + 2);
  }
  const double part = one_sided ? 0.0 : 1.0;
  const double C1 = dot(move[0], bt), C2 = dot(move[1], bt);  // C by the moves
  const double C3 = dot(move[2], ta), C4 = dot(move[3], ta);
  const double squared = at_least(part * (C1 * C1 + C2 * C2) + (C3 * C3 + C4 * C4));
  const double inverse = 1.0 / squared, by_g = std::sqrt(inverse);
  const Vec3 of_a = combination(part * C1, move[0], part * C2, move[1]);
  const Vec3 of_b = combination(C3, move[2], C4, move[3]);
  const Vec3 Cw = cross(a, bt), Ct = cross(a, b);
  const Vec3 gw = inverse * add_cross(cross(of_a, bt), a, cross(of_b, t));  // g' / g
  const Vec3 gt = inverse * add_cross(cross(of_a, b), a, of_b);
  const auto along1 = [&](const Vec3& v)
                          EPI360_INLINE_LAMBDA { return B[0] * v.x + B[2] * v.y + B[4] * v.z; };
  const auto along2 = [&](const Vec3& v)
                          EPI360_INLINE_LAMBDA { return B[1] * v.x + B[3] * v.y + B[5] * v.z; };
  Row row;
  const auto set = [&](std::size_t k, const Vec3& dCw, const Vec3& dCt, double dg, double dC)
                       EPI360_INLINE_LAMBDA {
                         row.by_w[k] = by_g * (dCw - combination(dg, Cw, dC, gw));
                         const Vec3 by_t = by_g * (dCt - combination(dg, Ct, dC, gt));
                         row.by_d1[k] = along1(by_t);
                         row.by_d2[k] = along2(by_t);
                       };
  set(0, cross(move[0], bt), cross(move[0], b), inverse * dot(of_b, cross(t, move[0])), C1);
  set(1, cross(move[1], bt), cross(move[1], b), inverse * dot(of_b, cross(t, move[1])), C2);
  const Vec3 bt3 = cross(move[2], t), bt4 = cross(move[3], t);
  set(2, cross(a, bt3), cross(a, move[2]), inverse * dot(of_a, bt3), C3);
  set(3, cross(a, bt4), cross(a, move[3]), inverse * dot(of_a, bt4), C4);
  const double d1 = along1(Ct), d2 = along2(Ct);
  row.squared_jacobian = inverse * (dot(Cw, Cw) + d1 * d1 + d2 * d2);
  return row;
}

template <bool has_pixels, bool one_sided>
EPI360_INLINE void loop(const Matches& m, const PlainPose& pose, const double* basis,
                        double* derivatives, double* squared_jacobian) {
  const PlainPose p = pose;
  const double B[6] = {basis[0], basis[1], basis[2], basis[3], basis[4], basis[5]};
  double squares[kBlock], D[kMoves][5][kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t j = 0; j < kBlock; ++j) {
      const Row row = second_derivatives<has_pixels, one_sided>(m, p, B, start + j);
      squares[j] = row.squared_jacobian;
      EPI360_UNROLL
      for (std::size_t k = 0; k < kMoves; ++k) {
        D[k][0][j] = row.by_w[k].x;
        D[k][1][j] = row.by_w[k].y;
        D[k][2][j] = row.by_w[k].z;
        D[k][3][j] = row.by_d1[k];
        D[k][4][j] = row.by_d2[k];
      }
    }
    std::copy(squares, squares + kBlock, squared_jacobian + start);
    for (std::size_t k = 0; k < 5 * kMoves; ++k) {
      const double* column = D[k / 5][k % 5];
      std::copy(column, column + kBlock, derivatives + k * m.padded + start);
    }
  }
}

}  // namespace

EPI360_MULTIVERSION
void compute_second_derivatives(const Matches& m, Residual kind, const PlainPose& pose,
                                const double* basis, double* derivatives,
                                double* squared_jacobian) {
  switch (kind) {
    case Residual::kTangentSampson:
      return loop<true, false>(m, pose, basis, derivatives, squared_jacobian);
    case Residual::kSampson:
      return loop<false, false>(m, pose, basis, derivatives, squared_jacobian);
    default:
      return loop<false, true>(m, pose, basis, derivatives, squared_jacobian);
  }
}

}  // namespace epi360
