// SPDX-License-Identifier: BSD-3-Clause
#include "core/surfaces/patches.h"

#include <cstring>

namespace epi360 {
namespace {

constexpr float kStep = 0.00610872946f;  // tan 0.35 degrees: a pixel of 1024
constexpr int kWindowX = 2 * (kPatchHalf + kAlong) + 1, kWindowY = 2 * (kPatchHalf + kAcross) + 1;
// Of shifts along a row so many are summed up together; there are fewer.
constexpr int kLanes = 8, kRowShifts = 2 * kAcross + 1;
static_assert(2 * kAlong + 1 <= kLanes);

#if defined(__GNUC__)
typedef float Lanes __attribute__((vector_size(kLanes * sizeof(float))));
#else
struct Lanes {
  float values[kLanes];

  float operator[](int lane) const { return values[lane]; }
  Lanes& operator+=(const Lanes& other) {
    for (int lane = 0; lane < kLanes; ++lane) values[lane] += other.values[lane];
    return *this;
  }
};
EPI360_INLINE Lanes operator*(const Lanes& a, const Lanes& b) {
  Lanes product;
  for (int lane = 0; lane < kLanes; ++lane) product.values[lane] = a.values[lane] * b.values[lane];
  return product;
}
EPI360_INLINE Lanes operator*(float scale, const Lanes& a) {
  Lanes product;
  for (int lane = 0; lane < kLanes; ++lane) product.values[lane] = scale * a.values[lane];
  return product;
}
#endif

constexpr int kWideLanes = 16;  // of the widest vectors
constexpr int whole_vectors(int count) {
  return (count + kWideLanes - 1) / kWideLanes * kWideLanes;
}
constexpr int kPatchRoom = whole_vectors(kPatchSize);
// The last of the lanes go beyond the last row.
constexpr int kWindowRoom = whole_vectors(kWindowX * kWindowY + kLanes - 1 - 2 * kAlong);

constexpr float kFlattest = 0.15f;  // cosine; patches on flatter planes are smeared
constexpr float kNearest = 0.02f, kFarthest = 1000.0f;  // depths, in units of the baseline
constexpr float kLikeEnough = 0.9f;

// Weights of a patch's samples: its middle counts most. The rest of the room counts nothing.
struct Weights {
  float values[kPatchRoom] = {};
  Weights() {
    float sum = 0.0f;
    for (int k = 0; k < kPatchSize; ++k) {
      const int x = k % kPatchSide - kPatchHalf, y = k / kPatchSide - kPatchHalf;
      values[k] = std::exp(-(x * x + y * y) / (2 * 0.49f * kPatchHalf * kPatchHalf));
      sum += values[k];
    }
    for (float& value : values) value /= sum;
  }
};
const Weights kWeights;

// Weighted sum of values of a patch's samples, all lanes at once.
template <typename Value>
EPI360_INLINE float weighted_sum(const Value& value) {
  float sums[kWideLanes] = {};
  for (int first = 0; first < kPatchRoom; first += kWideLanes) {
    for (int lane = 0; lane < kWideLanes; ++lane) {
      sums[lane] += kWeights.values[first + lane] * value(first + lane);
    }
  }
  for (int half = kWideLanes / 2; half > 0; half /= 2) {
    for (int lane = 0; lane < half; ++lane) sums[lane] += sums[lane + half];
  }
  return sums[0];
}

// Where the samples of a rectangle lie on a plane at distance 1, row by row.
template <int width, int height, int room>
struct Samples {
  float x[room], y[room];
  Samples() {
    for (int k = 0; k < room; ++k) {
      x[k] = kStep * static_cast<float>(k % width - width / 2);
      y[k] = kStep * static_cast<float>(k / width - height / 2);
    }
  }
};
const Samples<kPatchSide, kPatchSide, kPatchRoom> kPatchSamples;
const Samples<kWindowX, kWindowY, kWindowRoom> kWindowSamples;

EPI360_INLINE Vec3f turned(const float* R, const Vec3f& v) {
  return {R[0] * v.x + R[1] * v.y + R[2] * v.z, R[3] * v.x + R[4] * v.y + R[5] * v.z,
          R[6] * v.x + R[7] * v.y + R[8] * v.z};
}

// Blurred as much as samples that are so many pixels apart ask for.
EPI360_INLINE int level_for(float pixels_apart) {
  const int halvings = static_cast<int>(std::floor(std::log2(pixels_apart) + 0.5f));
  return std::min(std::max(halvings, -1), 2) + 1;
}

// Point of a plane through the end of the direction that a ray of the window meets, in the frame
// of the second camera.
struct Plane {
  Vec3f direction, along, across;  // turned into the second camera
  float facing, slope_along, slope_across, depth;

  Plane(const PanoramaPair& pair, const Patch& patch, float depth_, Vec3f normal)
      : direction(turned(pair.R, patch.direction)),
        along(turned(pair.R, patch.along)),
        across(turned(pair.R, patch.across)),
        depth(depth_) {
    facing = dot(normal, patch.direction);
    if (std::fabs(facing) < kFlattest) {
      normal = patch.direction;
      facing = 1.0f;
    }
    slope_along = dot(normal, patch.along) / facing;
    slope_across = dot(normal, patch.across) / facing;
  }

  EPI360_INLINE_LAMBDA Vec3f point(float x, float y) const {
    const float slope = 1.0f + x * slope_along + y * slope_across;
    const float stretch = slope > 1.0f / 3.0f ? std::min(1.0f / slope, 3.0f) : 3.0f;
    return depth * std::max(stretch, 0.3f) * (direction + x * along + y * across);
  }
};

// What the second panorama shows over the plane, with room for all shifts, row by row.
EPI360_INLINE void sample_window(const PanoramaPair& pair, const Plane& plane, float* window) {
  const Vec3f middle = plane.depth * plane.direction + pair.t;
  const float range = std::sqrt(dot(middle, middle));
  const unsigned char* level =
      pair.second.level(level_for(std::max(plane.depth / std::max(range, 1e-6f), 1e-3f)));
  Rays<kWindowRoom> rays;
  for (int k = 0; k < kWindowRoom; ++k) {
    rays.set(k, plane.point(kWindowSamples.x[k], kWindowSamples.y[k]) + pair.t);
  }
  values_along(pair.second, level, rays, window);
}

// Correlations of a patch with the window at each shift across the epipolar curve and along it.
EPI360_INLINE void correlate(const Patch& patch, const float* window, float (*likeness)[kLanes]) {
  Lanes mean[kRowShifts] = {}, square[kRowShifts] = {}, product[kRowShifts] = {};
  for (int y = 0; y < kPatchSide; ++y) {
    for (int x = 0; x < kPatchSide; ++x) {
      const int k = y * kPatchSide + x;
      EPI360_UNROLL
      for (int shift = 0; shift < kRowShifts; ++shift) {
        Lanes values;
        std::memcpy(&values, window + (y + shift) * kWindowX + x, sizeof values);
        const Lanes weighted = kWeights.values[k] * values;
        mean[shift] += weighted;
        square[shift] += weighted * values;
        product[shift] += patch.values[k] * values;
      }
    }
  }
  for (int shift = 0; shift < kRowShifts; ++shift) {
    for (int lane = 0; lane < kLanes; ++lane) {
      const float variance = square[shift][lane] - mean[shift][lane] * mean[shift][lane];
      likeness[shift][lane] = product[shift][lane] / std::sqrt(std::max(variance, 1.0f));
    }
  }
}

// Largest correlation over all shifts, and the shift along the epipolar curve that has it.
EPI360_INLINE float best_shift(const Patch& patch, const float* window, int* along) {
  float likeness[kRowShifts][kLanes];
  correlate(patch, window, likeness);
  float best = -2.0f;
  for (int sy = 0; sy < kRowShifts; ++sy) {
    for (int sx = 0; sx <= 2 * kAlong; ++sx) {
      if (likeness[sy][sx] > best) {
        best = likeness[sy][sx];
        *along = sx - kAlong;
      }
    }
  }
  return best;
}

// Depth along the patch's direction that lies nearest to the ray on which it was found.
float depth_of_shift(const PanoramaPair& pair, const Plane& plane, int along) {
  const Vec3f ray = unit(plane.point(along * kStep, 0.0f) + pair.t);
  const Vec3f here = cross(ray, plane.direction), there = cross(ray, pair.t);
  const float parallax = dot(here, here);
  if (along == 0 || parallax < 1e-4f) return plane.depth;
  const float depth = -dot(here, there) / parallax;
  return depth > kNearest && depth < kFarthest ? depth : plane.depth;
}

}  // namespace

PanoramaPair make_panorama_pair(const GreyPanorama& first, const GreyPanorama& second,
                                const double* rotation, const double* translation) {
  PanoramaPair pair{first, second, {}, {}, {}};
  for (int k = 0; k < 9; ++k) pair.R[k] = static_cast<float>(rotation[k]);
  pair.t = {static_cast<float>(translation[0]), static_cast<float>(translation[1]),
            static_cast<float>(translation[2])};
  const float* R = pair.R;
  const float transposed[9] = {R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]};
  pair.other_center = -1.0f * turned(transposed, pair.t);
  return pair;
}

EPI360_MULTIVERSION_WIDE
Patch patch_at(const PanoramaPair& pair, const Vec3f& direction) {
  Patch patch;
  patch.direction = direction;
  patch.along = unit(pair.other_center - dot(direction, pair.other_center) * direction);
  patch.across = cross(direction, patch.along);
  const unsigned char* level = pair.first.level(level_for(1.0f));
  Rays<kPatchRoom> rays;
  for (int k = 0; k < kPatchRoom; ++k) {
    const float x = kPatchSamples.x[k], y = kPatchSamples.y[k];
    rays.set(k, direction + x * patch.along + y * patch.across);
  }
  float values[kPatchRoom];
  values_along(pair.first, level, rays, values);
  const float mean = weighted_sum([&](int k) EPI360_INLINE_LAMBDA { return values[k]; });
  for (float& value : values) value -= mean;
  patch.contrast =
      std::sqrt(weighted_sum([&](int k) EPI360_INLINE_LAMBDA { return values[k] * values[k]; }));
  const float scale = 1.0f / std::max(patch.contrast, 1e-3f);
  for (int k = 0; k < kPatchSize; ++k) patch.values[k] = kWeights.values[k] * scale * values[k];
  return patch;
}

EPI360_MULTIVERSION_WIDE
Surface look_for(const PanoramaPair& pair, const Patch& patch, float depth, const Vec3f& normal) {
  const Plane plane(pair, patch, depth, normal);
  float window[kWindowRoom];
  sample_window(pair, plane, window);
  int along = 0;
  const float likeness = best_shift(patch, window, &along);
  return {likeness, depth_of_shift(pair, plane, along), normal};
}

Surface look_for_either(const PanoramaPair& pair, const Patch& patch, float depth,
                        const Vec3f& normal) {
  const Surface tilted = look_for(pair, patch, depth, normal);
  if (tilted.likeness >= kLikeEnough) return tilted;
  const Surface facing = look_for(pair, patch, depth, patch.direction);
  return facing.likeness > tilted.likeness ? facing : tilted;
}

}  // namespace epi360
