// SPDX-License-Identifier: BSD-3-Clause
// Patches of one panorama, looked for in another over a plane through a point of known depth.
#pragma once

#include "core/surfaces/grey_panorama.h"

namespace epi360 {

constexpr int kPatchHalf = 4, kPatchSide = 2 * kPatchHalf + 1;
constexpr int kPatchSize = kPatchSide * kPatchSide;
// A patch may lie elsewhere by so many samples, along the epipolar curve and across: poses have
// errors, and every sample more lets other things look alike.
constexpr int kAlong = 2, kAcross = 1;

// Two panoramas and the pose between them: x2 = R x1 + t, R row by row.
struct PanoramaPair {
  GreyPanorama first, second;
  float R[9];
  Vec3f t;
  Vec3f other_center;  // -R' t
};

PanoramaPair make_panorama_pair(const GreyPanorama& first, const GreyPanorama& second,
                                const double* rotation, const double* translation);

// What the first panorama shows around a direction: values less their mean, times weights, so
// that a product with other values is a correlation.
struct Patch {
  Vec3f direction, along, across;
  float contrast;  // standard deviation of the grey values
  float values[kPatchSize];
};

Patch patch_at(const PanoramaPair& pair, const Vec3f& direction);

// The surface that a patch shows, at a depth along its direction.
struct Surface {
  float likeness;  // correlation, from -1 to 1
  float depth;
  Vec3f normal;
};

// Looks for a patch where the second panorama must show it; the depth follows what is found.
Surface look_for(const PanoramaPair& pair, const Patch& patch, float depth, const Vec3f& normal);

// The better of this plane and of one that faces the camera.
Surface look_for_either(const PanoramaPair& pair, const Patch& patch, float depth,
                        const Vec3f& normal);

}  // namespace epi360
