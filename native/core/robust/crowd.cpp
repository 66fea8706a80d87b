// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/crowd.h"

#include "core/constants.h"
#include "core/pose.h"

namespace epi360 {
namespace {

// Times that the share of the inliers among the matches may be that of their regions. Of right
// poses of rendered and photographed rooms one in thirty has more, of wrong ones one in five.
constexpr double kCrowd = 1.8;
constexpr double kSamePose = 10.0 * kDegree;

}  // namespace

bool inliers_crowd(const Evidence& e) {
  return e.support * e.all_regions > kCrowd * e.num_regions * e.num_effective;
}

bool regions_confirm(const RobustResult& regions, const RobustResult& all) {
  return has_translation(judge(regions.evidence).status) &&
         same_pose(regions.cam2_from_cam1, all.cam2_from_cam1, kSamePose, kSamePose);
}

}  // namespace epi360
