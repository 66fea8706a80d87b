// SPDX-License-Identifier: BSD-3-Clause
#include "core/adjustment/normal_equations.h"

#include <algorithm>

#include "core/adjustment/observation.h"
#include "core/adjustment/profile_cholesky.h"

namespace epi360 {
namespace {

constexpr double kFloor = 1e-10;  // share of a block's size on its diagonal: none is singular
constexpr double kLargestStretch = 10.0;  // a step may bring a point so many times nearer, farther
constexpr int kPoseBlock = 21;  // numbers of a pose's block: w by w (upper), w by d, d by d (upper)

EPI360_INLINE Vec3 at(const double* values, std::size_t i) {
  return {values[3 * i], values[3 * i + 1], values[3 * i + 2]};
}

EPI360_INLINE void add(double* sum, const Vec3& v) {
  sum[0] += v.x;
  sum[1] += v.y;
  sum[2] += v.z;
}

EPI360_INLINE void set(double* out, const Vec3& v) {
  out[0] = v.x;
  out[1] = v.y;
  out[2] = v.z;
}

// M v of a symmetric matrix of which the upper triangle is given.
EPI360_INLINE Vec3 symmetric_product(const double* m, const Vec3& v) {
  return {m[0] * v.x + m[1] * v.y + m[2] * v.z, m[1] * v.x + m[3] * v.y + m[4] * v.z,
          m[2] * v.x + m[4] * v.y + m[5] * v.z};
}

EPI360_INLINE Vec3 column(const double* R, int k) { return {R[k], R[3 + k], R[6 + k]}; }

// Adds [x]x M [x]x^T (upper) and, of a point that is not a mere direction, [x]x M and M.
EPI360_INLINE void add_pose_block(const Vec3& x, const double* m, bool moves, double* block) {
  const Vec3 rows[3] = {{m[0], m[1], m[2]}, {m[1], m[3], m[4]}, {m[2], m[4], m[5]}};
  const Vec3 a[3] = {combination(x.y, rows[2], -x.z, rows[1]),
                     combination(x.z, rows[0], -x.x, rows[2]),
                     combination(x.x, rows[1], -x.y, rows[0])};
  const Vec3 first = cross(x, a[0]), second = cross(x, a[1]), third = cross(x, a[2]);
  add(block, first);
  block[3] += second.y;
  block[4] += second.z;
  block[5] += third.z;
  if (!moves) return;
  for (int i = 0; i < 3; ++i) add(block + 6 + 3 * i, a[i]);
  for (int i = 0; i < 6; ++i) block[15 + i] += m[i];
}

// A symmetric positive 3 x 3 matrix inverted by its Cholesky factor, both as upper triangles; zero
// if it is not positive.
EPI360_INLINE void invert(const double* m, double* inverse) {
  const double a = std::sqrt(m[0]), b = m[1] / a, c = m[2] / a, d = std::sqrt(m[3] - b * b);
  const double e = (m[4] - b * c) / d, f = std::sqrt(m[5] - c * c - e * e);
  const double ia = 1.0 / a, id = 1.0 / d, jf = 1.0 / f;
  const double ib = -b * ia * id, ie = -e * id * jf, ic = -(c * ia + e * ib) * jf;
  inverse[0] = ia * ia + ib * ib + ic * ic;
  inverse[1] = ib * id + ic * ie;
  inverse[2] = ic * jf;
  inverse[3] = id * id + ie * ie;
  inverse[4] = ie * jf;
  inverse[5] = jf * jf;
  if (!(std::isfinite(inverse[0] + inverse[3] + inverse[5]))) std::fill_n(inverse, 6, 0.0);
}

// Inverses of the damped blocks of all points. A point without observations gets zero: no step.
EPI360_INLINE void invert_points(const Window& w, double damping, WindowWorkspace& s) {
  for (std::size_t p = 0; p < w.num_points(); ++p) {
    double m[6];
    const double* own = s.points.data() + 6 * p;
    const double floor = kFloor * (own[0] + own[3] + own[5]);
    for (int i = 0; i < 6; ++i) m[i] = (1.0 + damping) * own[i];
    for (const int i : {0, 3, 5}) m[i] += floor;
    invert(m, s.inverses.data() + 6 * p);
  }
}

// The poses' damped blocks on the diagonal of the reduced system, and their gradients.
EPI360_INLINE void fill_poses(const Window& w, double damping, WindowWorkspace& s) {
  std::fill(s.reduced.begin(), s.reduced.end(), 0.0);
  for (std::size_t f = 0; f < w.num_frames(); ++f) {
    const std::uint32_t slot = s.slot[f];
    if (slot == kNoSlot) continue;
    const double* block = s.poses.data() + kPoseBlock * f;
    const std::size_t offset = 6 * (slot - s.first_column[6 * slot] / 6);
    const auto row = [&](int r) { return s.reduced.data() + s.row_start[6 * slot + r] + offset; };
    int k = 0;
    for (int i = 0; i < 3; ++i) {
      for (int j = i; j < 3; ++j, ++k) {
        row(j)[i] = (1.0 + damping) * block[k];
        row(3 + j)[3 + i] = (1.0 + damping) * block[15 + k];
      }
      for (int j = 0; j < 3; ++j) row(3 + j)[i] = (1.0 + damping) * block[6 + 3 * i + j];
    }
    for (int i = 0; i < 6; ++i) {
      double& own = row(i)[i];
      own = own > 0.0 ? own * (1.0 + kFloor / (1.0 + damping)) : 1.0;  // a frame that sees nothing
      s.pose_steps[6 * slot + i] = -s.pose_gradients[6 * f + i];
    }
  }
}

// Subtracts what the point takes away from the poses that see it.
EPI360_INLINE void eliminate_point(const Window& w, std::size_t p, WindowWorkspace& s) {
  const double* v = s.inverses.data() + 6 * p;
  const double* gradient = s.point_gradients.data() + 3 * p;
  const double inverse[9] = {v[0], v[1], v[2], v[1], v[3], v[4], v[2], v[4], v[5]};
  for (std::uint32_t a = s.first_seen[p]; a < s.first_seen[p + 1]; ++a) {
    const std::uint32_t slot = s.slot[w.frame[a]];
    if (slot == kNoSlot) continue;
    const double* mixed = s.mixed.data() + 18 * a;
    double y[18];  // V^-1 W^T
    for (int k = 0; k < 3; ++k) {
      for (int c = 0; c < 6; ++c) {
        y[6 * k + c] = inverse[3 * k] * mixed[c] + inverse[3 * k + 1] * mixed[6 + c] +
                       inverse[3 * k + 2] * mixed[12 + c];
      }
    }
    double* right = s.pose_steps.data() + 6 * slot;
    for (int c = 0; c < 6; ++c) {
      right[c] += y[c] * gradient[0] + y[6 + c] * gradient[1] + y[12 + c] * gradient[2];
    }
    const std::size_t first = s.first_column[6 * slot] / 6;
    for (std::uint32_t b = s.first_seen[p]; b < s.first_seen[p + 1]; ++b) {
      const std::uint32_t other = s.slot[w.frame[b]];
      if (other == kNoSlot || other > slot) continue;
      const double* z = s.mixed.data() + 18 * b;
      for (int r = 0; r < 6; ++r) {
        double* row = s.reduced.data() + s.row_start[6 * slot + r] + 6 * (other - first);
        const double y0 = y[r], y1 = y[6 + r], y2 = y[12 + r];
        for (int c = 0; c < 6; ++c) row[c] -= y0 * z[c] + y1 * z[6 + c] + y2 * z[12 + c];
      }
    }
  }
}

// The point after a step in direction and inverse distance from the nearest camera: to first order
// the same as point + step, and near infinity residuals are linear in it (window_reference.py).
EPI360_INLINE Vec3 stretched(const Vec3& point, const Vec3& ray, const Vec3& step) {
  const double square = dot(ray, ray);
  if (!(square > 0.0)) return point + step;
  const double along = dot(ray, step) / square;
  const double divisor = std::min(std::max(1.0 - along, 1.0 / kLargestStretch), kLargestStretch);
  const Vec3 moved = combination(1.0 - along, ray, 1.0, step);
  return combination(1.0, point - ray, 1.0 / divisor, moved);
}

// Steps of the points, once those of the poses are known.
EPI360_INLINE void move_points(const Window& w, WindowWorkspace& s) {
  std::copy(w.points.begin(), w.points.end(), s.trial_points.begin());
  for (std::size_t p = 0; p < w.num_points(); ++p) {
    Vec3 pull = at(s.point_gradients.data(), p), ray{0.0, 0.0, 0.0};
    double nearest = std::numeric_limits<double>::infinity();
    for (std::uint32_t a = s.first_seen[p]; a < s.first_seen[p + 1]; ++a) {
      const std::size_t f = w.frame[a];
      const double* R = w.rotations.data() + 9 * f;
      const Vec3 x = in_camera(R, w.translations.data() + 3 * f, at(w.points.data(), p));
      if (dot(x, x) < nearest) {
        nearest = dot(x, x);
        ray = {dot(column(R, 0), x), dot(column(R, 1), x), dot(column(R, 2), x)};
      }
      if (s.slot[f] == kNoSlot) continue;
      const double *step = s.pose_steps.data() + 6 * s.slot[f], *z = s.mixed.data() + 18 * a;
      double sums[3] = {0.0, 0.0, 0.0};
      for (int k = 0; k < 3; ++k) {
        for (int c = 0; c < 6; ++c) sums[k] += z[6 * k + c] * step[c];
      }
      pull = pull + Vec3(sums[0], sums[1], sums[2]);
    }
    if (s.first_seen[p] == s.first_seen[p + 1]) continue;
    const Vec3 step = -1.0 * symmetric_product(s.inverses.data() + 6 * p, pull);
    set(s.trial_points.data() + 3 * p, stretched(at(w.points.data(), p), ray, step));
  }
}

}  // namespace

EPI360_MULTIVERSION
double window_cost(const Window& w, const WindowOptions& options, const double* rotations,
                   const double* translations, const double* points) {
  const double precision = 1.0 / (options.noise * options.noise);
  double cost = 0.0;
  for (std::size_t i = 0; i < w.frame.size(); ++i) {
    const std::size_t f = w.frame[i];
    const Vec3 x = in_camera(rotations + 9 * f, translations + 3 * f, at(points, w.point[i]));
    const double angle = sight(at(w.bearings.data(), i), x).angle;
    cost += w.weights[i] * evaluate_loss(angle * angle * precision, options.loss).cost;
  }
  for (std::size_t f = 0; f < w.gravity_weights.size(); ++f) {
    const Vec3 x = product(rotations + 9 * f, at(w.world_gravity, 0));
    const double angle = sight(at(w.gravity.data(), f), x).angle;
    cost += w.gravity_weights[f] * angle * angle;
  }
  return cost;
}

void lay_out(const Window& w, const WindowOptions& options, WindowWorkspace& s) {
  const std::size_t F = w.num_frames(), P = w.num_points(), M = w.frame.size();
  std::uint32_t slots = 0;
  s.slot.assign(F, kNoSlot);
  for (std::size_t f = 0; f < F; ++f) {
    if (w.free_frame[f]) s.slot[f] = slots++;
  }
  s.first_seen.assign(P + 1, 0);
  for (std::size_t i = 0; i < M; ++i) ++s.first_seen[w.point[i] + 1];
  for (std::size_t p = 0; p < P; ++p) s.first_seen[p + 1] += s.first_seen[p];
  std::vector<std::uint32_t> first(slots);
  for (std::uint32_t a = 0; a < slots; ++a) first[a] = a;
  for (std::size_t p = 0; p < P && options.points_free; ++p) {
    std::uint32_t least = kNoSlot;
    for (auto i = s.first_seen[p]; i < s.first_seen[p + 1]; ++i) {
      least = std::min(least, s.slot[w.frame[i]]);
    }
    for (auto i = s.first_seen[p]; i < s.first_seen[p + 1]; ++i) {
      const std::uint32_t a = s.slot[w.frame[i]];
      if (a != kNoSlot) first[a] = std::min(first[a], least);
    }
  }
  s.first_column.resize(6 * slots);
  s.row_start.resize(6 * slots);
  std::size_t size = 0;
  for (std::uint32_t a = 0; a < slots; ++a) {
    for (std::uint32_t r = 6 * a; r < 6 * a + 6; ++r) {
      s.first_column[r] = 6 * first[a];
      s.row_start[r] = size;
      size += 6 * (a - first[a] + 1);
    }
  }
  s.reduced.resize(size);
  s.pose_steps.resize(6 * slots);
  s.poses.resize(kPoseBlock * F);
  s.pose_gradients.resize(6 * F);
  s.points.resize(6 * P);
  s.point_gradients.resize(3 * P);
  s.inverses.resize(6 * P);
  s.mixed.resize(options.points_free ? 18 * M : 0);
  s.trial_points.resize(3 * P);
}

EPI360_MULTIVERSION
void linearise(const Window& w, const WindowOptions& options, WindowWorkspace& s) {
  const double precision = 1.0 / (options.noise * options.noise);
  for (auto* sums : {&s.poses, &s.pose_gradients, &s.points, &s.point_gradients}) {
    std::fill(sums->begin(), sums->end(), 0.0);
  }
  for (std::size_t i = 0; i < w.frame.size(); ++i) {
    const std::size_t f = w.frame[i], p = w.point[i];
    const double* R = w.rotations.data() + 9 * f;
    const Vec3 x = in_camera(R, w.translations.data() + 3 * f, at(w.points.data(), p));
    const Sight seen = sight(at(w.bearings.data(), i), x);
    const double loss = evaluate_loss(seen.angle * seen.angle * precision, options.loss).weight;
    double m[6];
    Vec3 g;
    curvature(seen, w.weights[i] * loss * precision, m, &g);
    if (w.free_frame[f]) {
      add_pose_block(x, m, true, s.poses.data() + kPoseBlock * f);
      add(s.pose_gradients.data() + 6 * f, cross(x, g));
      add(s.pose_gradients.data() + 6 * f + 3, g);
    }
    if (!options.points_free) continue;
    double* block = s.points.data() + 6 * p;
    double* mixed = s.mixed.data() + 18 * i;
    for (int k = 0; k < 3; ++k) {
      const Vec3 n = symmetric_product(m, column(R, k));
      set(mixed + 6 * k, cross(x, n));
      set(mixed + 6 * k + 3, n);
      for (int j = 0; j <= k; ++j) block[3 * j - j * (j + 1) / 2 + k] += dot(column(R, j), n);
      s.point_gradients[3 * p + k] += dot(column(R, k), g);
    }
  }
  for (std::size_t f = 0; f < w.gravity_weights.size(); ++f) {
    const Vec3 x = product(w.rotations.data() + 9 * f, at(w.world_gravity, 0));
    double m[6];
    Vec3 g;
    curvature(sight(at(w.gravity.data(), f), x), w.gravity_weights[f], m, &g);
    add_pose_block(x, m, false, s.poses.data() + kPoseBlock * f);
    add(s.pose_gradients.data() + 6 * f, cross(x, g));
  }
}

EPI360_MULTIVERSION
bool solve_damped(const Window& w, const WindowOptions& options, double damping,
                  WindowWorkspace& s) {
  fill_poses(w, damping, s);
  if (options.points_free) {
    invert_points(w, damping, s);
    for (std::size_t p = 0; p < w.num_points(); ++p) eliminate_point(w, p, s);
  }
  if (!solve_profile(s.reduced.data(), s.row_start.data(), s.first_column.data(),
                     s.pose_steps.size(), s.pose_steps.data())) {
    return false;
  }
  if (options.points_free) move_points(w, s);
  return true;
}

}  // namespace epi360
