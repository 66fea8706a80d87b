// SPDX-License-Identifier: BSD-3-Clause
#include "core/residuals/residuals.h"

#include <algorithm>
#include <cmath>

#include "core/block_sum.h"
#include "core/multiversion.h"

namespace epi360 {
namespace {

constexpr std::size_t kBlock = Matches::kBlock;
// Least squared denominator: at an epipole residual and Jacobian stay finite, and their product
// with a weight of zero is zero.
constexpr double kLeast = 1e-20;

// All residuals are C / sqrt(D) with C = t . (a x b), a = R b1, b = b2:
//   paper, signed sine (eq. 13)       D = |t x a|^2
//   angular, asin of the same         D = |t x a|^2
//   Sampson on the sphere             D = |t x a|^2 + |t x b|^2 - 2 C^2
//   tangent Sampson                   D = |(R J1)^T (b x t)|^2 + |J2^T (t x a)|^2
// (Terekhov & Larsson, "Tangent Sampson error", ICCV 2023, for the last; the third is the same with
// an isotropic tangent basis as Jacobian.)
struct Geometry {
  double ax, ay, az, bx, by, bz;  // the rotated bearing of view 1, the bearing of view 2
  double ta, tb, C;
};

EPI360_INLINE Geometry geometry_of(const Matches& m, const PlainPose& p, std::size_t i) {
  Geometry g;
  const double x = m.x1[i], y = m.y1[i], z = m.z1[i];
  g.ax = p.R[0] * x + p.R[1] * y + p.R[2] * z;
  g.ay = p.R[3] * x + p.R[4] * y + p.R[5] * z;
  g.az = p.R[6] * x + p.R[7] * y + p.R[8] * z;
  g.bx = m.x2[i];
  g.by = m.y2[i];
  g.bz = m.z2[i];
  g.ta = p.t[0] * g.ax + p.t[1] * g.ay + p.t[2] * g.az;
  g.tb = p.t[0] * g.bx + p.t[1] * g.by + p.t[2] * g.bz;
  g.C = p.t[0] * (g.ay * g.bz - g.az * g.by) + p.t[1] * (g.az * g.bx - g.ax * g.bz) +
        p.t[2] * (g.ax * g.by - g.ay * g.bx);
  return g;
}

EPI360_INLINE double lesser(double a, double b) { return a < b ? a : b; }

EPI360_INLINE double at_least(double squared) { return squared > kLeast ? squared : kLeast; }

// The smaller of two numbers with the signs of the depths: parallax of the wrong sign, in radians,
// where it is negative.
EPI360_INLINE double depth_margin(const Geometry& g) {
  const double c = g.ax * g.bx + g.ay * g.by + g.az * g.bz;
  return lesser(c * g.tb - g.ta, g.tb - c * g.ta);
}

// The four numbers whose squares sum to D of tangent Sampson: gradients of C by the pixels.
struct PixelGradient {
  double bt[3], ta[3];  // b x t and t x a
  double c1[3], c2[3];  // columns of R J1
  double g1, g2, g3, g4;
};

EPI360_INLINE PixelGradient pixel_gradient(const Matches& m, const PlainPose& p, const Geometry& g,
                                           std::size_t i) {
  PixelGradient q;
  q.bt[0] = g.by * p.t[2] - g.bz * p.t[1];
  q.bt[1] = g.bz * p.t[0] - g.bx * p.t[2];
  q.bt[2] = g.bx * p.t[1] - g.by * p.t[0];
  q.ta[0] = p.t[1] * g.az - p.t[2] * g.ay;
  q.ta[1] = p.t[2] * g.ax - p.t[0] * g.az;
  q.ta[2] = p.t[0] * g.ay - p.t[1] * g.ax;
  for (int r = 0; r < 3; ++r) {
    q.c1[r] = p.R[3 * r] * m.u1x[i] + p.R[3 * r + 1] * m.u1y[i] + p.R[3 * r + 2] * m.u1z[i];
    q.c2[r] = p.R[3 * r] * m.v1x[i] + p.R[3 * r + 1] * m.v1y[i] + p.R[3 * r + 2] * m.v1z[i];
  }
  q.g1 = q.c1[0] * q.bt[0] + q.c1[1] * q.bt[1] + q.c1[2] * q.bt[2];
  q.g2 = q.c2[0] * q.bt[0] + q.c2[1] * q.bt[1] + q.c2[2] * q.bt[2];
  q.g3 = m.u2x[i] * q.ta[0] + m.u2y[i] * q.ta[1] + m.u2z[i] * q.ta[2];
  q.g4 = m.v2x[i] * q.ta[0] + m.v2y[i] * q.ta[1] + m.v2z[i] * q.ta[2];
  return q;
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

// Results go through local blocks: the compiler knows that they alias nothing and vectorises.
template <Residual kind>
EPI360_INLINE void residual_loop(const Matches& m, const PlainPose& pose, double tolerance,
                                 double* residuals, double* in_front) {
  const PlainPose p = pose;
  double r[kBlock], f[kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t j = 0; j < kBlock; ++j) {
      const Geometry g = geometry_of(m, p, start + j);
      r[j] = g.C / std::sqrt(at_least(squared_denominator<kind>(m, p, g, start + j)));
      f[j] = depth_margin(g) > -tolerance ? 1.0 : 0.0;
    }
    std::copy(r, r + kBlock, residuals + start);
    std::copy(f, f + kBlock, in_front + start);
  }
}

// With s = C D^(-1/2): ds = D^(-1/2) (dC - C dD / (2 D)).
struct JacobianRow {
  double residual, in_front, J[5];
};

template <Residual kind>
EPI360_INLINE JacobianRow jacobian_row(const Matches& m, const PlainPose& p, const double* B,
                                       double tolerance, std::size_t i) {
  JacobianRow out;
  const Geometry g = geometry_of(m, p, i);
  out.in_front = depth_margin(g) > -tolerance ? 1.0 : 0.0;
  // Gradients by a (then rotated to w by a x grad) and by t.
  const double cx = g.ay * g.bz - g.az * g.by, cy = g.az * g.bx - g.ax * g.bz,
               cz = g.ax * g.by - g.ay * g.bx;  // a x b = dC / dt
  const double ex = g.by * p.t[2] - g.bz * p.t[1], ey = g.bz * p.t[0] - g.bx * p.t[2],
               ez = g.bx * p.t[1] - g.by * p.t[0];  // b x t = dC / da
  double D, hw[3], ht[3];                           // D and half its gradient by w and by t
  if (kind == Residual::kTangentSampson) {
    const PixelGradient q = pixel_gradient(m, p, g, i);
    D = q.g1 * q.g1 + q.g2 * q.g2 + q.g3 * q.g3 + q.g4 * q.g4;
    const double ux = m.u2x[i], uy = m.u2y[i], uz = m.u2z[i];
    const double vx = m.v2x[i], vy = m.v2y[i], vz = m.v2z[i];
    // g1 = c1 . (b x t): by w: c1 x (b x t); by t: c1 x b. g3 = u . (t x a): by w: a x (u x t);
    // by t: a x u.
    const double k1 = q.g1, k2 = q.g2;
    const double sx = k1 * q.c1[0] + k2 * q.c2[0], sy = k1 * q.c1[1] + k2 * q.c2[1],
                 sz = k1 * q.c1[2] + k2 * q.c2[2];
    const double rx = q.g3 * ux + q.g4 * vx, ry = q.g3 * uy + q.g4 * vy, rz = q.g3 * uz + q.g4 * vz;
    const double fx = ry * p.t[2] - rz * p.t[1], fy = rz * p.t[0] - rx * p.t[2],
                 fz = rx * p.t[1] - ry * p.t[0];  // r x t
    hw[0] = sy * q.bt[2] - sz * q.bt[1] + g.ay * fz - g.az * fy;
    hw[1] = sz * q.bt[0] - sx * q.bt[2] + g.az * fx - g.ax * fz;
    hw[2] = sx * q.bt[1] - sy * q.bt[0] + g.ax * fy - g.ay * fx;
    ht[0] = sy * g.bz - sz * g.by + g.ay * rz - g.az * ry;
    ht[1] = sz * g.bx - sx * g.bz + g.az * rx - g.ax * rz;
    ht[2] = sx * g.by - sy * g.bx + g.ax * ry - g.ay * rx;
  } else {
    // D = k - ta^2 [- tb^2 - 2 C^2]; half gradients by a: -ta t - 2 C (b x t), by t: -ta a -...
    const bool sampson = kind == Residual::kSampson;
    const double tb = sampson ? g.tb : 0.0, C2 = sampson ? 2.0 * g.C : 0.0;
    D = sampson ? 2.0 - g.ta * g.ta - g.tb * g.tb - 2.0 * g.C * g.C : 1.0 - g.ta * g.ta;
    const double hx = -g.ta * p.t[0] - C2 * ex, hy = -g.ta * p.t[1] - C2 * ey,
                 hz = -g.ta * p.t[2] - C2 * ez;
    hw[0] = g.ay * hz - g.az * hy;
    hw[1] = g.az * hx - g.ax * hz;
    hw[2] = g.ax * hy - g.ay * hx;
    ht[0] = -g.ta * g.ax - tb * g.bx - C2 * cx;
    ht[1] = -g.ta * g.ay - tb * g.by - C2 * cy;
    ht[2] = -g.ta * g.az - tb * g.bz - C2 * cz;
  }
  const double inverse = 1.0 / std::sqrt(at_least(D));
  const double s = g.C * inverse, share = s * inverse;  // C / D
  out.residual = s;
  const double gx = inverse * (cx - share * ht[0]), gy = inverse * (cy - share * ht[1]),
               gz = inverse * (cz - share * ht[2]);
  out.J[0] = inverse * (g.ay * ez - g.az * ey - share * hw[0]);
  out.J[1] = inverse * (g.az * ex - g.ax * ez - share * hw[1]);
  out.J[2] = inverse * (g.ax * ey - g.ay * ex - share * hw[2]);
  out.J[3] = B[0] * gx + B[2] * gy + B[4] * gz;
  out.J[4] = B[1] * gx + B[3] * gy + B[5] * gz;
  return out;
}

template <Residual kind>
EPI360_INLINE void jacobian_loop(const Matches& m, const PlainPose& pose, const double* basis,
                                 double tolerance, double* residuals, double* in_front,
                                 double* jacobian) {
  const PlainPose p = pose;
  const double B[6] = {basis[0], basis[1], basis[2], basis[3], basis[4], basis[5]};
  double r[kBlock], f[kBlock], J[5][kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t j = 0; j < kBlock; ++j) {
      const JacobianRow row = jacobian_row<kind>(m, p, B, tolerance, start + j);
      r[j] = row.residual;
      f[j] = row.in_front;
      for (int k = 0; k < 5; ++k) J[k][j] = row.J[k];
    }
    std::copy(r, r + kBlock, residuals + start);
    std::copy(f, f + kBlock, in_front + start);
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
  double total = 0.0;
  double cost[kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t j = 0; j < kBlock; ++j) {
      const std::size_t i = start + j;
      const Geometry g = geometry_of(m, p, i);
      const double D = at_least(squared_denominator<kind>(m, p, g, i));
      cost[j] = m.weight[i] * truncated_mean(g.C * g.C / D, depth_margin(g), gates, several);
    }
    total += block_sum(cost);
    if (total > limit) break;
  }
  return total;
}

template <bool several>
EPI360_INLINE double rotation_score_loop(const Matches& m, const double* R, const Gates& gates,
                                         double limit) {
  double total = 0.0;
  double cost[kBlock];
  for (std::size_t start = 0; start < m.padded; start += kBlock) {
    for (std::size_t j = 0; j < kBlock; ++j) {
      const std::size_t i = start + j;
      const double x = m.x1[i], y = m.y1[i], z = m.z1[i];
      const double dx = R[0] * x + R[1] * y + R[2] * z - m.x2[i];
      const double dy = R[3] * x + R[4] * y + R[5] * z - m.y2[i];
      const double dz = R[6] * x + R[7] * y + R[8] * z - m.z2[i];
      // The chord is the angle to first order; half of its square is the Sampson distance squared.
      cost[j] =
          m.weight[i] * truncated_mean(0.5 * (dx * dx + dy * dy + dz * dz), 0.0, gates, several);
    }
    total += block_sum(cost);
    if (total > limit) break;
  }
  return total;
}

}  // namespace

EPI360_MULTIVERSION
void compute_residuals(const Matches& m, Residual kind, const PlainPose& pose, double tolerance,
                       double* residuals, double* in_front) {
  switch (kind) {
    case Residual::kSampson:
      return residual_loop<Residual::kSampson>(m, pose, tolerance, residuals, in_front);
    case Residual::kTangentSampson:
      return residual_loop<Residual::kTangentSampson>(m, pose, tolerance, residuals, in_front);
    case Residual::kPaper:
      return residual_loop<Residual::kPaper>(m, pose, tolerance, residuals, in_front);
    case Residual::kAngular:
      residual_loop<Residual::kPaper>(m, pose, tolerance, residuals, in_front);
      for (std::size_t i = 0; i < m.padded; ++i) {
        residuals[i] = std::asin(residuals[i] > 1.0    ? 1.0
                                 : residuals[i] < -1.0 ? -1.0
                                                       : residuals[i]);
      }
  }
}

EPI360_MULTIVERSION
void compute_jacobians(const Matches& m, Residual kind, const PlainPose& pose, const double* basis,
                       double tolerance, double* residuals, double* in_front, double* jacobian) {
  switch (kind) {
    case Residual::kSampson:
      return jacobian_loop<Residual::kSampson>(m, pose, basis, tolerance, residuals, in_front,
                                               jacobian);
    case Residual::kTangentSampson:
      return jacobian_loop<Residual::kTangentSampson>(m, pose, basis, tolerance, residuals,
                                                      in_front, jacobian);
    case Residual::kPaper:
      return jacobian_loop<Residual::kPaper>(m, pose, basis, tolerance, residuals, in_front,
                                             jacobian);
    case Residual::kAngular:
      jacobian_loop<Residual::kPaper>(m, pose, basis, tolerance, residuals, in_front, jacobian);
      for (std::size_t i = 0; i < m.padded; ++i) {
        const double s = residuals[i] > 1.0 ? 1.0 : residuals[i] < -1.0 ? -1.0 : residuals[i];
        const double slope = 1.0 / std::sqrt(1.0 - s * s + 1e-30);
        residuals[i] = std::asin(s);
        for (int k = 0; k < 5; ++k) jacobian[k * m.padded + i] *= slope;
      }
  }
}

EPI360_MULTIVERSION
double truncated_score(const Matches& m, Residual kind, const PlainPose& pose, const double* gates,
                       int num_gates, double limit) {
  const Gates g = make_gates(gates, num_gates);
  const bool several = num_gates > 1;
  switch (kind) {
    case Residual::kSampson:
      return several ? score_loop<Residual::kSampson, true>(m, pose, g, limit)
                     : score_loop<Residual::kSampson, false>(m, pose, g, limit);
    case Residual::kTangentSampson:
      return several ? score_loop<Residual::kTangentSampson, true>(m, pose, g, limit)
                     : score_loop<Residual::kTangentSampson, false>(m, pose, g, limit);
    default:  // the sine and the angle differ by less than the gate's own meaning
      return several ? score_loop<Residual::kPaper, true>(m, pose, g, limit)
                     : score_loop<Residual::kPaper, false>(m, pose, g, limit);
  }
}

EPI360_MULTIVERSION
double truncated_rotation_score(const Matches& m, const double* R, const double* gates,
                                int num_gates, double limit) {
  const Gates g = make_gates(gates, num_gates);
  return num_gates > 1 ? rotation_score_loop<true>(m, R, g, limit)
                       : rotation_score_loop<false>(m, R, g, limit);
}

EPI360_MULTIVERSION
void compute_rotation_residuals(const Matches& m, const double* R, double* residuals) {
  for (std::size_t i = 0; i < m.padded; ++i) {
    const double x = m.x1[i], y = m.y1[i], z = m.z1[i];
    const double dx = R[0] * x + R[1] * y + R[2] * z - m.x2[i];
    const double dy = R[3] * x + R[4] * y + R[5] * z - m.y2[i];
    const double dz = R[6] * x + R[7] * y + R[8] * z - m.z2[i];
    const double half_chord = 0.5 * std::sqrt(dx * dx + dy * dy + dz * dz);
    residuals[i] = std::sqrt(2.0) * std::asin(half_chord < 1.0 ? half_chord : 1.0);
  }
}

// Eight lanes a sum, carried over all blocks: the order of additions does not depend on the vector
// width, and nothing is added across lanes before the end (measured: 2.3 times as fast).
EPI360_MULTIVERSION
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
