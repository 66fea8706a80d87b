// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/rival.h"

#include <algorithm>
#include <cmath>

#include "core/robust/plane.h"
#include "core/robust/verdict.h"

namespace epi360 {
namespace {

constexpr double kDistinct = 4.0;  // standard deviations

// Whether two poses differ by more than the uncertainty of the first can explain.
bool is_distinct(const RelativePose& a, const RelativePose& b,
                 const Eigen::Matrix<double, 5, 5>& covariance) {
  const double sigma_rotation = std::sqrt(covariance.topLeftCorner<3, 3>().trace());
  const double sigma_direction = std::sqrt(covariance.bottomRightCorner<2, 2>().trace());
  return !same_pose(a, b, std::max(3.0 * kDegree, kDistinct * sigma_rotation),
                    std::max(8.0 * kDegree, kDistinct * sigma_direction));
}

}  // namespace

Rival find_rival(const Matches& m, Candidates& candidates, const RelativePose& pose,
                 const Eigen::Matrix<double, 5, 5>& covariance,
                 const std::vector<unsigned char>& inlier, double gate) {
  Rival rival;
  const double evidence = candidates.best().evidence;
  const Eigen::Vector3d plane = fit_plane(m, pose, inlier, 1.5 * gate, &rival.plane_share);
  RelativePose twin;
  if (is_planar(rival.plane_share) && twin_pose(pose, plane, &twin)) {
    candidates.polish(twin, 50, 1e-8);
    rival.has_twin = true;
  }
  for (const Candidate& c : candidates.all()) {  // descending evidence
    if (!is_distinct(pose, c.cam2_from_cam1, covariance)) continue;
    rival.cam2_from_cam1 = c.cam2_from_cam1;
    rival.loss = c.loss;
    rival.evidence = c.evidence - evidence;
    break;
  }
  return rival;
}

}  // namespace epi360
