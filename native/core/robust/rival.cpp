// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/rival.h"

#include <algorithm>
#include <cmath>

#include "core/robust/plane.h"
#include "core/robust/verdict.h"

namespace epi360 {
namespace {

constexpr double kDistinct = 4.0;  // standard deviations
// A pose so near by is the same answer: with the uncertainty of both, neither is 10 degrees wrong.
constexpr double kNearby = 8.0 * kDegree;

// Whether two poses differ by more than the uncertainty of the first can explain.
bool is_distinct(const RelativePose& a, const RelativePose& b,
                 const Eigen::Matrix<double, 5, 5>& covariance) {
  const double sigma_rotation = std::sqrt(covariance.topLeftCorner<3, 3>().trace());
  const double sigma_direction = std::sqrt(covariance.bottomRightCorner<2, 2>().trace());
  return !same_pose(a, b, std::max(3.0 * kDegree, kDistinct * sigma_rotation),
                    std::max(8.0 * kDegree, kDistinct * sigma_direction));
}

}  // namespace

Rivals find_rivals(const Matches& m, Candidates& candidates, const RelativePose& pose,
                   const Eigen::Matrix<double, 5, 5>& covariance,
                   const std::vector<unsigned char>& inlier, double gate) {
  Rivals rivals;
  const double evidence = candidates.best().evidence;
  const Eigen::Vector3d plane = fit_plane(m, pose, inlier, 1.5 * gate, &rivals.plane_share);
  RelativePose twin;
  if (is_planar(rivals.plane_share) && twin_pose(pose, plane, &twin)) {
    candidates.polish(twin, 50, 1e-8);
    rivals.has_twin = true;
  }
  for (const Candidate& c : candidates.all()) {  // descending evidence
    if (!is_distinct(pose, c.cam2_from_cam1, covariance)) continue;
    const bool is_nearby = same_pose(pose, c.cam2_from_cam1, kNearby, kNearby);
    Rival& rival = is_nearby ? rivals.nearby : rivals.distant;
    if (!rival.cam2_from_cam1) rival = {c.cam2_from_cam1, c.loss, c.evidence - evidence};
    if (rivals.distant.cam2_from_cam1) break;
  }
  return rivals;
}

Eigen::Matrix<double, 5, 5> second_moment(const RelativePose& pose, const RelativePose& other,
                                          double probability) {
  const Eigen::AngleAxisd turn(other.R * pose.R.transpose());
  Eigen::Matrix<double, 5, 1> apart;
  apart << turn.angle() * turn.axis(),
      tangent_basis(pose.t).transpose() * other.t / other.t.dot(pose.t);
  return probability * apart * apart.transpose();
}

}  // namespace epi360
