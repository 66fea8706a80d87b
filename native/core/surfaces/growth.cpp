// SPDX-License-Identifier: BSD-3-Clause
#include "core/surfaces/growth.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <queue>

namespace epi360 {
namespace {

constexpr float kFound = 0.7f;          // likeness of what is the same
constexpr float kLikeEnough = 0.9f;     // is not tried again
constexpr float kBetterBy = 0.02f;      // or a cell would change for ever
constexpr float kLeastContrast = 4.0f;  // grey values; less than that is a bare wall
constexpr int kMostTries = 24, kMostTriesFound = 6;
constexpr float kOneSurface = 0.25f, kAbout = 0.3f;  // logarithms of depths
constexpr int kFewestAround = 5, kFewestOfPlane = 4;
constexpr float kFlattest = 0.1f;

using Points = std::array<Vec3f, SphereGrid::kAround + 1>;

struct FittedPlane {
  Vec3f normal, middle;
};

struct Vector {
  double x, y, z;
};

struct SymmetricMatrix {
  double xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;

  double trace() const { return xx + yy + zz; }

  Vector times(const Vector& v) const {
    return {xx * v.x + xy * v.y + xz * v.z, xy * v.x + yy * v.y + yz * v.z,
            xz * v.x + yz * v.y + zz * v.z};
  }

  SymmetricMatrix squared() const {
    return {xx * xx + xy * xy + xz * xz, xx * xy + xy * yy + xz * yz, xx * xz + xy * yz + xz * zz,
            xy * xy + yy * yy + yz * yz, xy * xz + yy * yz + yz * zz, xz * xz + yz * yz + zz * zz};
  }

  // The inverse but for a factor: of trace 1, so that its powers neither vanish nor overflow.
  SymmetricMatrix inverse() const {
    const SymmetricMatrix m{yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy,
                            xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy};
    const double scale = 1.0 / std::max(m.trace(), 1e-300);
    return {scale * m.xx, scale * m.xy, scale * m.xz, scale * m.yy, scale * m.yz, scale * m.zz};
  }
};

// Plane through points. Inverse iteration starts at the viewing direction: where points lie on a
// line, the plane through it that faces the camera most comes out. Its twelve steps are three
// squarings: the twelfth power is the eighth times the fourth.
FittedPlane plane_through(const Points& points, int count, const Vec3f& direction) {
  Vec3f middle{0, 0, 0};
  for (int k = 0; k < count; ++k) middle = middle + points[k];
  middle = (1.0f / count) * middle;
  SymmetricMatrix spread;
  for (int k = 0; k < count; ++k) {
    const Vec3f p = points[k] - middle;
    spread.xx += p.x * p.x;
    spread.xy += p.x * p.y;
    spread.xz += p.x * p.z;
    spread.yy += p.y * p.y;
    spread.yz += p.y * p.z;
    spread.zz += p.z * p.z;
  }
  const double damping = 1e-3 * spread.trace() + 1e-12;
  spread.xx += damping;
  spread.yy += damping;
  spread.zz += damping;
  const SymmetricMatrix fourth = spread.inverse().squared().squared();
  const Vector normal =
      fourth.squared().times(fourth.times({direction.x, direction.y, direction.z}));
  const double length = std::sqrt(normal.x * normal.x + normal.y * normal.y + normal.z * normal.z);
  const double scale = 1.0 / std::max(length, 1e-300);
  return {{static_cast<float>(scale * normal.x), static_cast<float>(scale * normal.y),
           static_cast<float>(scale * normal.z)},
          middle};
}

struct Queued {
  float likeness;
  std::int32_t cell;
  bool operator<(const Queued& other) const {
    return likeness < other.likeness || (likeness == other.likeness && cell > other.cell);
  }
};

class Growth {
 public:
  Growth(const PanoramaPair& pair, const SphereGrid& grid)
      : pair_(pair), grid_(grid), tries_(grid.count, 0), log_depth_(grid.count, 0.0f) {
    patches_.reserve(grid.count);
    found_.contrast.resize(grid.count);
    for (std::size_t i = 0; i < grid.count; ++i) {
      patches_.push_back(patch_at(pair, grid.direction(i)));
      found_.contrast[i] = patches_[i].contrast;
    }
    found_.depth.assign(grid.count, 0.0f);
    found_.likeness.assign(grid.count, -1.0f);
    found_.normal.assign(3 * grid.count, 0.0f);
    found_.expected_depth.assign(grid.count, 0.0f);
    found_.expected_likeness.assign(grid.count, -1.0f);
  }

  void start(const Seeds& seeds) {
    for (std::size_t s = 0; s < seeds.count; ++s) {
      const std::int32_t i = seeds.cells[s];
      if (is_bare(i)) continue;
      // Surfaces that face either camera, and the floor.
      const Vec3f& direction = patches_[i].direction;
      const Vec3f point = seeds.depths[s] * direction;
      const Vec3f between = direction + unit(point - pair_.other_center);
      Surface best = look_for(pair_, patches_[i], seeds.depths[s], direction);
      for (const Vec3f& normal : {unit(between), Vec3f{0, 1, 0}}) {
        const Surface surface = look_for(pair_, patches_[i], seeds.depths[s], normal);
        if (surface.likeness > best.likeness) best = surface;
      }
      ++tries_[i];
      if (best.likeness > kFound && best.likeness > found_.likeness[i]) keep(i, best);
    }
  }

  void grow() {
    while (!queue_.empty()) {
      const Queued top = queue_.top();
      queue_.pop();
      if (top.likeness < found_.likeness[top.cell]) continue;
      const FittedPlane plane = plane_of(top.cell);
      for (int k = 0; k < SphereGrid::kNeighbours; ++k) {
        const std::int32_t j = grid_.neighbours[SphereGrid::kNeighbours * top.cell + k];
        if (wants_a_try(j, top.likeness)) attempt(j, top.cell, plane);
      }
    }
  }

  // Compares every cell where those around it say that it must be, found or not.
  void look_where_expected() {
    for (std::size_t i = 0; i < grid_.count; ++i) {
      if (is_bare(static_cast<std::int32_t>(i))) continue;
      Points points;
      std::array<float, SphereGrid::kAround> logs, ordered;
      int count = 0;
      for (int k = 0; k < SphereGrid::kAround; ++k) {
        const std::int32_t j = grid_.around[SphereGrid::kAround * i + k];
        if (found_.depth[j] <= 0.0f) continue;
        points[count] = point(j);
        logs[count++] = log_depth_[j];
      }
      if (count < kFewestAround) continue;
      ordered = logs;
      const auto middle_place = ordered.begin() + count / 2;
      std::nth_element(ordered.begin(), middle_place, ordered.begin() + count);
      const float middle = *middle_place;
      int near = 0;
      for (int k = 0; k < count; ++k) {
        if (std::fabs(logs[k] - middle) < kAbout) points[near++] = points[k];
      }
      expect(i, std::exp(middle), points, near);
    }
  }

  SharedSurfaces take() { return std::move(found_); }

 private:
  bool is_bare(std::int32_t i) const { return found_.contrast[i] < kLeastContrast; }
  Vec3f point(std::size_t i) const { return found_.depth[i] * grid_.direction(i); }

  void keep(std::int32_t i, const Surface& surface) {
    found_.depth[i] = surface.depth;
    log_depth_[i] = std::log(surface.depth);
    found_.likeness[i] = surface.likeness;
    found_.normal[3 * i] = surface.normal.x;
    found_.normal[3 * i + 1] = surface.normal.y;
    found_.normal[3 * i + 2] = surface.normal.z;
    queue_.push({surface.likeness, i});
  }

  bool wants_a_try(std::int32_t j, float likeness) const {
    const float has = found_.likeness[j];
    if (is_bare(j) || has >= kLikeEnough || has >= likeness) return false;
    return tries_[j] <= (has > 0.0f ? kMostTriesFound : kMostTries);
  }

  // Plane of a cell and of those of its neighbours that lie at about its depth.
  FittedPlane plane_of(std::int32_t i) const {
    Points points;
    points[0] = point(i);
    int count = 1;
    for (int k = 0; k < SphereGrid::kNeighbours; ++k) {
      const std::int32_t j = grid_.neighbours[SphereGrid::kNeighbours * i + k];
      if (found_.depth[j] <= 0.0f) continue;
      if (std::fabs(log_depth_[j] - log_depth_[i]) >= kOneSurface) continue;
      points[count++] = point(j);
    }
    const Vec3f own{found_.normal[3 * i], found_.normal[3 * i + 1], found_.normal[3 * i + 2]};
    if (count < kFewestOfPlane) return {own, points[0]};
    const FittedPlane plane = plane_through(points, count, patches_[i].direction);
    const bool is_flat = std::fabs(dot(plane.normal, patches_[i].direction)) < kFlattest;
    return {is_flat ? own : plane.normal, points[0]};
  }

  // Looks for a cell on the plane of its neighbour, and facing the camera at its depth.
  void attempt(std::int32_t j, std::int32_t neighbour, const FittedPlane& plane) {
    const Patch& patch = patches_[j];
    const float beside = found_.depth[neighbour];
    const float facing = dot(plane.normal, patch.direction);
    const float depth = facing != 0.0f ? dot(plane.normal, plane.middle) / facing : -1.0f;
    Surface best{-2.0f, 0.0f, plane.normal};
    if (depth > 0.5f * beside && depth < 2.0f * beside) {
      best = look_for(pair_, patch, depth, plane.normal);
    }
    if (best.likeness < kLikeEnough) {
      const Surface other = look_for(pair_, patch, beside, patch.direction);
      if (other.likeness > best.likeness) best = other;
    }
    ++tries_[j];
    if (best.likeness > kFound && best.likeness > found_.likeness[j] + kBetterBy) keep(j, best);
  }

  void expect(std::size_t i, float depth, const Points& points, int count) {
    Vec3f normal = patches_[i].direction;
    if (count >= kFewestAround) {
      const FittedPlane plane = plane_through(points, count, normal);
      const float facing = dot(plane.normal, normal);
      const float on_plane =
          std::fabs(facing) > kFlattest ? dot(plane.normal, plane.middle) / facing : -1.0f;
      if (on_plane > 0.6f * depth && on_plane < 1.6f * depth) {
        depth = on_plane;
        normal = plane.normal;
      }
    }
    found_.expected_depth[i] = depth;
    found_.expected_likeness[i] = look_for_either(pair_, patches_[i], depth, normal).likeness;
  }

  const PanoramaPair& pair_;
  const SphereGrid& grid_;
  std::vector<Patch> patches_;
  std::vector<int> tries_;
  std::vector<float> log_depth_;  // where something was found
  SharedSurfaces found_;
  std::priority_queue<Queued> queue_;
};

}  // namespace

SharedSurfaces grow_surfaces(const PanoramaPair& pair, const SphereGrid& grid, const Seeds& seeds) {
  Growth growth(pair, grid);
  growth.start(seeds);
  growth.grow();
  growth.look_where_expected();
  return growth.take();
}

}  // namespace epi360
