// SPDX-License-Identifier: BSD-3-Clause
#include "core/surfaces/patches.h"

namespace epi360 {
namespace {

constexpr float kStep = 0.00610872946f;  // tan 0.35 degrees: a pixel of 1024
constexpr int kWindowX = 2 * (kPatchHalf + kAlong) + 1, kWindowY = 2 * (kPatchHalf + kAcross) + 1;
constexpr int kWindow = kWindowX * kWindowY;
constexpr float kFlattest = 0.15f;  // cosine; patches on flatter planes are smeared
constexpr float kNearest = 0.02f, kFarthest = 1000.0f;  // depths, in units of the baseline
constexpr float kLikeEnough = 0.9f;

// Weights of a patch's samples: its middle counts most.
struct Weights {
  float values[kPatchSize];
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

// Values of the second panorama over the plane, a window that has room for all shifts.
EPI360_INLINE void sample_window(const PanoramaPair& pair, const Plane& plane, float* window) {
  const Vec3f middle = plane.depth * plane.direction + pair.t;
  const float range = std::sqrt(dot(middle, middle));
  const unsigned char* level =
      pair.second.level(level_for(std::max(plane.depth / std::max(range, 1e-6f), 1e-3f)));
  float u[kWindow], v[kWindow];
  for (int k = 0; k < kWindow; ++k) {
    const float x = static_cast<float>(k % kWindowX - kPatchHalf - kAlong);
    const float y = static_cast<float>(k / kWindowX - kPatchHalf - kAcross);
    pixel_of(pair.second, plane.point(x * kStep, y * kStep) + pair.t, &u[k], &v[k]);
  }
  for (int k = 0; k < kWindow; ++k) window[k] = value_at(pair.second, level, u[k], v[k]);
}

// Largest correlation over all shifts, and the shift along the epipolar curve that has it.
EPI360_INLINE float best_shift(const Patch& patch, const float* window, int* along) {
  float best = -2.0f;
  for (int sy = 0; sy <= 2 * kAcross; ++sy) {
    for (int sx = 0; sx <= 2 * kAlong; ++sx) {
      float mean = 0.0f, square = 0.0f, product = 0.0f;
      for (int y = 0; y < kPatchSide; ++y) {
        const float* row = window + (y + sy) * kWindowX + sx;
        const float* weights = kWeights.values + y * kPatchSide;
        const float* values = patch.values + y * kPatchSide;
        for (int x = 0; x < kPatchSide; ++x) {
          mean += weights[x] * row[x];
          square += weights[x] * row[x] * row[x];
          product += values[x] * row[x];
        }
      }
      const float likeness = product / std::sqrt(std::max(square - mean * mean, 1.0f));
      if (likeness > best) {
        best = likeness;
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

EPI360_MULTIVERSION Patch patch_at(const PanoramaPair& pair, const Vec3f& direction) {
  Patch patch;
  patch.direction = direction;
  patch.along = unit(pair.other_center - dot(direction, pair.other_center) * direction);
  patch.across = cross(direction, patch.along);
  const unsigned char* level = pair.first.level(level_for(1.0f));
  float mean = 0.0f;
  for (int k = 0; k < kPatchSize; ++k) {
    const float x = (k % kPatchSide - kPatchHalf) * kStep;
    const float y = (k / kPatchSide - kPatchHalf) * kStep;
    float u, v;
    pixel_of(pair.first, direction + x * patch.along + y * patch.across, &u, &v);
    patch.values[k] = value_at(pair.first, level, u, v);
    mean += kWeights.values[k] * patch.values[k];
  }
  float variance = 0.0f;
  for (int k = 0; k < kPatchSize; ++k) {
    patch.values[k] -= mean;
    variance += kWeights.values[k] * patch.values[k] * patch.values[k];
  }
  patch.contrast = std::sqrt(variance);
  const float scale = 1.0f / std::max(patch.contrast, 1e-3f);
  for (int k = 0; k < kPatchSize; ++k) patch.values[k] *= kWeights.values[k] * scale;
  return patch;
}

EPI360_MULTIVERSION Surface look_for(const PanoramaPair& pair, const Patch& patch, float depth,
                                     const Vec3f& normal) {
  const Plane plane(pair, patch, depth, normal);
  float window[kWindow];
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
