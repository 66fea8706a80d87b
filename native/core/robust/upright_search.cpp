// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/upright_search.h"

#include <algorithm>
#include <cmath>

#include "core/bearings.h"
#include "core/constants.h"
#include "core/robust/heading_scores.h"
#include "core/robust/testimony.h"
#include "core/solvers/upright.h"

namespace epi360 {
namespace {

constexpr int kHeadings = 180, kAzimuths = 45;  // azimuths of half a turn: both signs at once
constexpr double kReach = 2.0 * kDegree;        // residuals beyond it count nothing
constexpr double kApart = 8.0 * kDegree;        // headings of different poses
constexpr double kTurn = 6.283185307179586;

// A pose on the grid and what it scores.
struct Level {
  double score = -1.0, heading = 0.0, azimuth = 0.0;
};

Level best_direction(const LevelMatches& m, double heading, TurnedMatches& turned) {
  turn_matches(m, heading, turned);
  Level best;
  for (int k = 0; k < kAzimuths; ++k) {
    const double azimuth = 0.5 * kTurn * k / kAzimuths;
    double scores[2];
    score_direction(m, turned, std::sin(azimuth), std::cos(azimuth), kReach, &scores[0],
                    &scores[1]);
    for (int sign = 0; sign < 2; ++sign) {
      if (scores[sign] <= best.score) continue;
      best = {scores[sign], heading, azimuth + 0.5 * kTurn * sign};
    }
  }
  return best;
}

LevelMatches levelled(const Matches& m, const PosePrior& prior, const Eigen::Matrix3d& upright1,
                      const Eigen::Matrix3d& upright2) {
  LevelMatches out(m.size);
  const std::vector<double> votes = votes_of(m, prior);
  for (std::size_t i = 0; i < m.size; ++i) {
    const Eigen::Vector3d a = upright1 * view1(m, i), b = upright2 * view2(m, i);
    out.x1[i] = a.x();
    out.y1[i] = a.y();
    out.z1[i] = a.z();
    out.x2[i] = b.x();
    out.y2[i] = b.y();
    out.z2[i] = b.z();
    out.weight[i] = votes[i];
  }
  return out;
}

}  // namespace

std::vector<RelativePose> upright_poses(const Matches& all, const PosePrior& prior, int most) {
  const Matches m = witnesses(all, 0);
  const Eigen::Matrix3d upright1 = upright_from(prior.gravity1);
  const Eigen::Matrix3d upright2 = upright_from(prior.gravity2);
  const LevelMatches matches = levelled(m, prior, upright1, upright2);
  TurnedMatches turned(matches.padded());
  std::vector<Level> levels;
  for (int k = 0; k < kHeadings; ++k) {
    levels.push_back(best_direction(matches, kTurn * k / kHeadings, turned));
  }
  std::stable_sort(levels.begin(), levels.end(),
                   [](const Level& a, const Level& b) { return a.score > b.score; });
  std::vector<Level> chosen;
  for (const Level& level : levels) {
    const bool is_new = std::none_of(chosen.begin(), chosen.end(), [&](const Level& other) {
      return std::abs(std::remainder(level.heading - other.heading, kTurn)) < kApart;
    });
    if (is_new) chosen.push_back(level);
    if (static_cast<int>(chosen.size()) == most) break;
  }
  std::vector<RelativePose> poses;
  for (const Level& level : chosen) {
    const double c = std::cos(level.heading), s = std::sin(level.heading);
    Eigen::Matrix3d turn;
    turn << c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c;
    RelativePose pose;
    pose.R = upright2.transpose() * turn * upright1;
    pose.t = upright2.transpose() *
             Eigen::Vector3d(std::sin(level.azimuth), 0.0, std::cos(level.azimuth));
    poses.push_back(pose);
  }
  return poses;
}

}  // namespace epi360
