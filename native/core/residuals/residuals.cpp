// SPDX-License-Identifier: BSD-3-Clause
#include "core/residuals/residuals.h"

#include <algorithm>
#include <cmath>
#include <type_traits>

#include "core/block_sum.h"
#include "core/multiversion.h"
#include "core/residuals/denominator.h"
#include "core/vector3.h"

namespace epi360 {
namespace {

constexpr std::size_t kBlock = Matches::kBlock;

// All residuals are C / sqrt(D) with C = t . (a x b), a = R b1, b = b2:
//   paper, signed sine (eq. 13)       D = |t x a|^2
//   angular, asin of the same         D = |t x a|^2
//   Sampson on the sphere             D = |t x a|^2 + |t x b|^2 - 2 C^2
//   tangent Sampson                   D = |(R J1)^T (b x t)|^2 + |J2^T (t x a)|^2
// (Terekhov & Larsson, "Tangent Sampson error", ICCV 2023, for the last; the third is the same with
// an isotropic tangent basis as Jacobian.)
struct Geometry {
  Vec3 t, a, b, normal;  // normal: a x b
  double ta, tb, C;
};

EPI360_INLINE Geometry geometry_of(const Matches& m, const PlainPose& p, std::size_t i) {
  const Vec3 t{p.t[0], p.t[1], p.t[2]};
  const Vec3 a = product(p.R, bearing1(m, i)), b = bearing2(m, i), normal = cross(a, b);
  return {t, a, b, normal, dot(t, a), dot(t, b), dot(t, normal)};
}

EPI360_INLINE double lesser(double a, double b) { return a < b ? a : b; }

// The smaller of two numbers with the signs of the depths: parallax of the wrong sign, in radians,
// where it is negative.
EPI360_INLINE double depth_margin(const Geometry& g) {
  const double c = dot(g.a, g.b);
  return lesser(c * g.tb - g.ta, g.tb - c * g.ta);
}

// The four numbers whose squares sum to D of tangent Sampson: gradients of C by the pixels.
struct PixelGradient {
  Vec3 c1, c2, u, v;  // columns of R J1 and of J2
  double g1, g2, g3, g4;
};

EPI360_INLINE PixelGradient pixel_gradient(const Matches& m, const PlainPose& p, const Geometry& g,
                                           std::size_t i) {
  const Vec3 bt = cross(g.b, g.t), ta = cross(g.t, g.a);
  const Vec3 c1 = product(p.R, {m.u1x[i], m.u1y[i], m.u1z[i]});
  const Vec3 c2 = product(p.R, {m.v1x[i], m.v1y[i], m.v1z[i]});
  const Vec3 u{m.u2x[i], m.u2y[i], m.u2z[i]}, v{m.v2x[i], m.v2y[i], m.v2z[i]};
  return {c1, c2, u, v, dot(c1, bt), dot(c2, bt), dot(u, ta), dot(v, ta)};
}

template <Residual kind>
EPI360_INLINE double squared_denominator(const Matches& m, const PlainPose& p, const Geometry& g,
                                         std::size_t i) {
  if (kind == Residual::kSampson) return 2.0 - g.ta * g.ta - g.tb * g.tb - 2.0 * g.C * g.C;
  if (kind == Residual::kTangentSampson) {
    const PixelGradient q = pixel_gradient(m, p, g, i);
    return q.g1 * q.g1 + q.g2 * q.g2 + q.g3 * q.g3 + q.g4 * q.g4;
  }
  return 1.0 - g.ta * g.ta;
}

// Results go through local blocks: see block_sum.h.
template <Residual kind>
EPI360_INLINE void residual_loop(const Matches& m, const PlainPose& pose, double* residuals,
                                 double* margins) {
  const PlainPose p = pose;
  double r[kBlock], f[kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t j = 0; j < kBlock; ++j) {
      const Geometry g = geometry_of(m, p, start + j);
      r[j] = g.C / std::sqrt(at_least(squared_denominator<kind>(m, p, g, start + j)));
      f[j] = depth_margin(g);
    }
    std::copy(r, r + kBlock, residuals + start);
    std::copy(f, f + kBlock, margins + start);
  }
}

// With s = C D^(-1/2): ds = D^(-1/2) (dC - C dD / (2 D)).
struct JacobianRow {
  double residual, margin, J[5];
};

template <Residual kind>
EPI360_INLINE JacobianRow jacobian_row(const Matches& m, const PlainPose& p, const double* B,
                                       std::size_t i) {
  const Geometry g = geometry_of(m, p, i);
  // Gradients by a, turned into those by w by a x gradient, and by t: dC / da = b x t and
  // dC / dt = a x b.
  const Vec3 bt = cross(g.b, g.t);
  Vec3 hw, ht;  // half the gradient of D by w and by t
  if (kind == Residual::kTangentSampson) {
    // g1 = c1 . (b x t): by w: c1 x (b x t); by t: c1 x b. g3 = u . (t x a): by w: a x (u x t);
    // by t: a x u.
    const PixelGradient q = pixel_gradient(m, p, g, i);
    const Vec3 s = combination(q.g1, q.c1, q.g2, q.c2), r = combination(q.g3, q.u, q.g4, q.v);
    hw = add_cross(cross(s, bt), g.a, cross(r, g.t));
    ht = add_cross(cross(s, g.b), g.a, r);
  } else {
    // Half gradients by a: -ta t [- 2 C (b x t)], by t: -ta a [- tb b - 2 C (a x b)].
    const bool sampson = kind == Residual::kSampson;
    const double tb = sampson ? g.tb : 0.0, C2 = sampson ? 2.0 * g.C : 0.0;
    hw = cross(g.a, combination(-g.ta, g.t, -C2, bt));
    ht = combination(-g.ta, g.a, -tb, g.b) - C2 * g.normal;
  }
  const double inverse = 1.0 / std::sqrt(at_least(squared_denominator<kind>(m, p, g, i)));
  const double s = g.C * inverse, share = s * inverse;  // C / D
  const Vec3 by_w = inverse * (cross(g.a, bt) - share * hw);
  const Vec3 by_t = inverse * (g.normal - share * ht);
  return {s,
          depth_margin(g),
          {by_w.x, by_w.y, by_w.z, B[0] * by_t.x + B[2] * by_t.y + B[4] * by_t.z,
           B[1] * by_t.x + B[3] * by_t.y + B[5] * by_t.z}};
}

template <Residual kind>
EPI360_INLINE void jacobian_loop(const Matches& m, const PlainPose& pose, const double* basis,
                                 double* residuals, double* margins, double* jacobian) {
  const PlainPose p = pose;
  const double B[6] = {basis[0], basis[1], basis[2], basis[3], basis[4], basis[5]};
  double r[kBlock], f[kBlock], J[5][kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t j = 0; j < kBlock; ++j) {
      const JacobianRow row = jacobian_row<kind>(m, p, B, start + j);
      r[j] = row.residual;
      f[j] = row.margin;
      for (int k = 0; k < 5; ++k) J[k][j] = row.J[k];
    }
    std::copy(r, r + kBlock, residuals + start);
    std::copy(f, f + kBlock, margins + start);
    for (int k = 0; k < 5; ++k) std::copy(J[k], J[k] + kBlock, jacobian + k * m.padded + start);
  }
}

struct Gates {
  double gate[4], inverse[4];  // 1 / gate^2; unused ones repeat the last
};

EPI360_INLINE Gates make_gates(const double* gates, int num_gates) {
  Gates g;
  for (int k = 0; k < 4; ++k) {
    g.gate[k] = gates[k < num_gates ? k : num_gates - 1];
    g.inverse[k] = 1.0 / (g.gate[k] * g.gate[k]);
  }
  return g;
}

// min(squared / gate^2, 1), or 1 where the depths are wrong by more than the gate.
EPI360_INLINE double truncated(double squared, double margin, const Gates& g, int k) {
  return margin > -g.gate[k] ? lesser(squared * g.inverse[k], 1.0) : 1.0;
}

EPI360_INLINE double truncated_mean(double squared, double margin, const Gates& g, bool several) {
  const double first = truncated(squared, margin, g, 0);
  if (!several) return first;
  return 0.25 * (first + truncated(squared, margin, g, 1) + truncated(squared, margin, g, 2) +
                 truncated(squared, margin, g, 3));
}

template <Residual kind, bool several>
EPI360_INLINE double score_loop(const Matches& m, const PlainPose& pose, const Gates& gates,
                                double limit) {
  const PlainPose p = pose;
  const auto cost = [&](std::size_t i) EPI360_INLINE_LAMBDA {
    const Geometry g = geometry_of(m, p, i);
    const double D = at_least(squared_denominator<kind>(m, p, g, i));
    return m.weight[i] * truncated_mean(g.C * g.C / D, depth_margin(g), gates, several);
  };
  return sum_of_terms(m.padded, cost, limit);
}

EPI360_INLINE double squared_chord(const Matches& m, const double* R, std::size_t i) {
  const Vec3 d = product(R, bearing1(m, i)) - bearing2(m, i);
  return dot(d, d);
}

template <bool several>
EPI360_INLINE double rotation_score_loop(const Matches& m, const double* R, const Gates& gates,
                                         double limit) {
  // The chord is the angle to first order; half of its square is the Sampson distance squared.
  const auto cost = [&](std::size_t i) EPI360_INLINE_LAMBDA {
    return m.weight[i] * truncated_mean(0.5 * squared_chord(m, R, i), 0.0, gates, several);
  };
  return sum_of_terms(m.padded, cost, limit);
}

EPI360_INLINE double within_one(double sine) {
  return sine > 1.0 ? 1.0 : sine < -1.0 ? -1.0 : sine;
}

template <Residual kind>
using Kind = std::integral_constant<Residual, kind>;

// The angle is computed as its sine.
template <typename Loop>
EPI360_INLINE auto with_kind(Residual kind, const Loop& loop) {
  if (kind == Residual::kSampson) return loop(Kind<Residual::kSampson>());
  if (kind == Residual::kTangentSampson) return loop(Kind<Residual::kTangentSampson>());
  return loop(Kind<Residual::kPaper>());
}

}  // namespace

EPI360_MULTIVERSION_WIDE
void compute_residuals(const Matches& m, Residual kind, const PlainPose& pose, double* residuals,
                       double* margins) {
  with_kind(kind, [&](auto loop_kind) EPI360_INLINE_LAMBDA {
    residual_loop<loop_kind>(m, pose, residuals, margins);
  });
  if (kind != Residual::kAngular) return;
  for (std::size_t i = 0; i < m.padded; ++i) residuals[i] = std::asin(within_one(residuals[i]));
}

EPI360_MULTIVERSION_WIDE
void compute_jacobians(const Matches& m, Residual kind, const PlainPose& pose, const double* basis,
                       double* residuals, double* margins, double* jacobian) {
  with_kind(kind, [&](auto loop_kind) EPI360_INLINE_LAMBDA {
    jacobian_loop<loop_kind>(m, pose, basis, residuals, margins, jacobian);
  });
  if (kind != Residual::kAngular) return;
  for (std::size_t i = 0; i < m.padded; ++i) {
    const double s = within_one(residuals[i]);
    const double slope = 1.0 / std::sqrt(1.0 - s * s + 1e-30);
    residuals[i] = std::asin(s);
    for (int k = 0; k < 5; ++k) jacobian[k * m.padded + i] *= slope;
  }
}

// The sine serves for the angle here: they differ by less than the gate's own meaning.
EPI360_MULTIVERSION_WIDE
double truncated_score(const Matches& m, Residual kind, const PlainPose& pose, const double* gates,
                       int num_gates, double limit) {
  const Gates g = make_gates(gates, num_gates);
  return with_kind(kind, [&](auto loop_kind) EPI360_INLINE_LAMBDA {
    return num_gates > 1 ? score_loop<loop_kind, true>(m, pose, g, limit)
                         : score_loop<loop_kind, false>(m, pose, g, limit);
  });
}

EPI360_MULTIVERSION_WIDE
double truncated_rotation_score(const Matches& m, const double* R, const double* gates,
                                int num_gates, double limit) {
  const Gates g = make_gates(gates, num_gates);
  return num_gates > 1 ? rotation_score_loop<true>(m, R, g, limit)
                       : rotation_score_loop<false>(m, R, g, limit);
}

EPI360_MULTIVERSION_WIDE
void compute_rotation_residuals(const Matches& m, const double* R, double* residuals) {
  for (std::size_t i = 0; i < m.padded; ++i) {
    const double half_chord = 0.5 * std::sqrt(squared_chord(m, R, i));
    residuals[i] = std::sqrt(2.0) * std::asin(half_chord < 1.0 ? half_chord : 1.0);
  }
}

// Eight lanes a sum, carried over all blocks: the order of additions does not depend on the vector
// width, and nothing is added across lanes before the end (measured: 2.3 times as fast).
EPI360_MULTIVERSION_WIDE
void accumulate_normal_equations(std::size_t padded, const double* jacobian,
                                 const double* residuals, const double* weights, double* hessian,
                                 double* gradient) {
  double sums[20][kLanes] = {};
  for (std::size_t start = 0; start < padded; start += kBlock) {
    int entry = 0;
    for (std::size_t p = 0; p < 5; ++p) {
      double scaled[kBlock];
      const double* row = jacobian + p * padded + start;
      for (std::size_t j = 0; j < kBlock; ++j) scaled[j] = weights[start + j] * row[j];
      for (std::size_t q = p; q <= 5; ++q) {  // the sixth column is the residual
        const double* column = q < 5 ? jacobian + q * padded + start : residuals + start;
        double* sum = sums[entry++];
        for (std::size_t j = 0; j < kLanes; ++j) {
          sum[j] += (scaled[j] * column[j] + scaled[j + 8] * column[j + 8]) +
                    (scaled[j + 16] * column[j + 16] + scaled[j + 24] * column[j + 24]);
        }
      }
    }
  }
  int entry = 0;
  for (int p = 0; p < 5; ++p) {
    for (int q = p; q <= 5; ++q) {
      const double sum = lane_sum(sums[entry++]);
      if (q < 5) {
        *hessian++ = sum;
      } else {
        gradient[p] = sum;
      }
    }
  }
}

}  // namespace epi360
