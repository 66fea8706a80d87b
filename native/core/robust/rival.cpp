// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/rival.h"

#include <algorithm>
#include <cmath>

#include "core/robust/covariance.h"
#include "core/robust/plane.h"
#include "core/robust/verdict.h"

namespace epi360 {
namespace {

constexpr double kDistinct = 4.0;  // standard deviations
constexpr double kDistinctRotation = 3.0 * kDegree, kDistinctDirection = 8.0 * kDegree;
// A pose so near by, or within the uncertainty, is the same answer, less well known.
constexpr double kNearby = 8.0 * kDegree;

}  // namespace

Rivals find_rivals(const Matches& m, Candidates& candidates, const RelativePose& pose,
                   const Eigen::Matrix<double, 5, 5>& covariance,
                   const std::vector<unsigned char>& inlier, double gate) {
  Rivals rivals;
  const Candidate best = candidates.best();
  const Eigen::Vector3d plane = fit_plane(m, pose, inlier, 1.5 * gate, &rivals.plane_share);
  RelativePose twin;
  if (is_planar(rivals.plane_share) && twin_pose(pose, plane, &twin)) {
    candidates.polish(twin, 50, 1e-8);
    rivals.has_twin = true;
  }
  candidates.sharpen(best);
  // Whether two poses differ by more than the uncertainty can explain, and by more than these
  // angles.
  const auto differ = [&](const RelativePose& a, const RelativePose& b, double least_rotation,
                          double least_direction) {
    return !same_pose(a, b, std::max(least_rotation, kDistinct * rotation_sigma(covariance)),
                      std::max(least_direction, kDistinct * direction_sigma(covariance)));
  };
  const auto is_other = [&](const RelativePose& a, const RelativePose& b) {
    return differ(a, b, kSameRotation, kSameDirection);
  };
  const auto as_rival = [&](const Candidate& c) {
    return Rival{c.cam2_from_cam1, c.loss, candidates.lead(c, best)};
  };
  for (const Candidate& c : candidates.all()) {  // descending evidence
    const bool is_distinct = differ(pose, c.cam2_from_cam1, kDistinctRotation, kDistinctDirection);
    if (!is_distinct || same_pose(pose, c.cam2_from_cam1, kNearby, kNearby)) {
      bool is_new = is_other(pose, c.cam2_from_cam1);
      for (const Rival& known : rivals.nearby) {
        is_new = is_new && is_other(known.cam2_from_cam1, c.cam2_from_cam1);
      }
      if (is_new) rivals.nearby.push_back(as_rival(c));
    } else if (!rivals.distant) {
      rivals.distant = as_rival(c);
    }
  }
  return rivals;
}

Eigen::Matrix<double, 5, 5> second_moment(const RelativePose& pose, const RelativePose& other,
                                          double probability) {
  const Eigen::AngleAxisd turn(other.R * pose.R.transpose());
  const Eigen::Vector2d aside = tangent_basis(pose.t).transpose() * other.t;
  const double angle = std::atan2(aside.norm(), other.t.dot(pose.t));
  Eigen::Matrix<double, 5, 1> apart;
  apart << turn.angle() * turn.axis(), angle / std::max(aside.norm(), 1e-12) * aside;
  return probability * apart * apart.transpose();
}

}  // namespace epi360
