// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/one_side.h"

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "core/bearings.h"
#include "core/constants.h"
#include "core/refinement/refine.h"
#include "core/robust/around_camera.h"
#include "core/robust/covariance.h"
#include "core/robust/evidence.h"
#include "core/robust/fixed_content.h"
#include "core/robust/matches_left.h"
#include "core/robust/random.h"
#include "core/robust/rival_search.h"

namespace epi360 {
namespace {

// A side is what lies in the cells within so much of one of them, and moved so many times more than
// the median of the others.
constexpr std::array<double, 3> kSides = {35.0 * kDegree, 60.0 * kDegree, 85.0 * kDegree};
constexpr double kMovedMore = 2.0;
constexpr std::size_t kFewestOnSide = 6;
// Without it the variance of the direction is so many times larger.
constexpr double kSaysMost = 10.0;
// The search among the others: samples, the least share that a pose is taken to explain, and the
// angle between its direction and that of the answer from which on they are asked in earnest.
constexpr int kMostSamples = 50;
constexpr double kHalfOfInliers = 0.5, kLeastSearched = 0.3, kMayContradict = 8.0 * kDegree;
// Beside all inliers so many samples, of which nine in ten times one is of a pose that explains 0.3
// of what is left; and so many inliers, over those of the answer.
constexpr int kMostBesideAll = 1000;
constexpr double kLeastBesideAll = 0.3;
// Both directions differ by so much, and so many standard deviations of both; and the others have
// this share of the regions of the answer.
constexpr double kContradicts = 10.0 * kDegree, kDeviationsApart = 4.0, kLeastRegions = 0.6;
// Times by which the median of a side moved more than nine tenths of what only turned: nothing that
// stands still is so much nearer than all else.
constexpr double kCannotStandStill = 15.0;
// The parallax of the others goes the way of the pose by so many standard deviations; or of few,
// four in five do.
constexpr double kSignsAgree = 8.0, kFewSignsAgree = 2.5, kMostSigns = 0.6;

struct SideCell {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Matrix<double, 5, 5> information = Eigen::Matrix<double, 5, 5>::Zero();
  std::size_t count = 0;

  bool is_near(const SideCell& middle, double angle) const {
    return count > 0 && centre.dot(middle.centre) > std::cos(angle);
  }
};

using SideCells = std::array<SideCell, kNumCells>;

SideCells cells_of_inliers(const Matches& m, Residual residual, const RelativePose& pose,
                           const std::vector<unsigned char>& inlier) {
  Linearisation at;
  at.resize(m.padded);
  const Eigen::Matrix<double, 3, 2, Eigen::RowMajor> basis = tangent_basis(pose.t);
  compute_jacobians(m, residual, plain(pose), basis.data(), at.residuals.data(), at.margins.data(),
                    at.jacobian.data());
  SideCells cells;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!inlier[i]) continue;
    const Eigen::Matrix<double, 5, 1> J = jacobian_of(at, m.padded, i);
    SideCell& cell = cells[cell_of(view1(m, i))];
    cell.information += m.weight[i] * J * J.transpose();
    cell.centre += view1(m, i);
    cell.count += 1;
  }
  for (SideCell& cell : cells) cell.centre.normalize();
  return cells;
}

// Variance of the direction, in units of that of the residuals.
double direction_variance(const Eigen::Matrix<double, 5, 5>& information) {
  const Eigen::LDLT<Eigen::Matrix<double, 5, 5>> solver(information);
  const Eigen::Matrix<double, 5, 2> columns =
      solver.solve(Eigen::Matrix<double, 5, 5>::Identity().rightCols<2>());
  return columns.bottomRows<2>().trace();
}

// All that is not within an angle of the middle of a side.
SideCell others_of(const SideCells& cells, const SideCell& middle, double angle) {
  SideCell others;
  for (const SideCell& cell : cells) {
    if (cell.is_near(middle, angle)) continue;
    others.information += cell.information;
    others.count += cell.count;
  }
  return others;
}

double largest_usual_variance(const SideCells& cells) {
  Eigen::Matrix<double, 5, 5> all = Eigen::Matrix<double, 5, 5>::Zero();
  for (const SideCell& cell : cells) all += cell.information;
  return kSaysMost * direction_variance(all);
}

// Whether a side may say most: a narrower one says less than a wider one around it, so that most
// pairs need no second look.
bool may_say_most(const SideCells& cells, double widest, double usual) {
  return std::any_of(cells.begin(), cells.end(), [&](const SideCell& middle) {
    if (middle.count == 0) return false;
    const SideCell others = others_of(cells, middle, widest);
    return others.count < kFewestOnSide || direction_variance(others.information) > usual;
  });
}

// The middle of the side without which the direction is known least; none if it is known as well.
const SideCell* side_that_says_most(const SideCells& cells, double angle, double usual) {
  const SideCell* most = nullptr;
  double largest = usual;
  for (const SideCell& middle : cells) {
    if (middle.count == 0) continue;
    const SideCell others = others_of(cells, middle, angle);
    if (others.count < kFewestOnSide) continue;
    const double variance = direction_variance(others.information);
    if (!(variance > largest)) continue;
    largest = variance;
    most = &middle;
  }
  return most;
}

double squared_parallax(const Matches& m, const RelativePose& pose, std::size_t i) {
  return (pose.R * view1(m, i) - view2(m, i)).squaredNorm();
}

double value_at(std::vector<double> values, double share) {
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

// Inliers on a side that moved more than those elsewhere.
std::vector<std::size_t> moved_on_side(const Matches& m, const RelativePose& pose,
                                       const std::vector<unsigned char>& inlier,
                                       const SideCells& cells, const SideCell& middle,
                                       double angle) {
  std::vector<std::size_t> inside;
  std::vector<double> elsewhere;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!inlier[i]) continue;
    if (cells[cell_of(view1(m, i))].is_near(middle, angle)) {
      inside.push_back(i);
    } else {
      elsewhere.push_back(squared_parallax(m, pose, i));
    }
  }
  const double usual = kMovedMore * kMovedMore * value_at(std::move(elsewhere), 0.5);
  inside.erase(std::remove_if(inside.begin(), inside.end(),
                              [&](std::size_t i) { return squared_parallax(m, pose, i) <= usual; }),
               inside.end());
  return inside;
}

// Whether a short search among the matches that are not on a side finds another direction.
bool may_contradict(const Matches& m, const RobustOptions& options, const MatchPriors& priors,
                    std::uint64_t seed, const RobustResult& answer,
                    const std::vector<std::size_t>& side) {
  const std::vector<unsigned char> on_side = mask_of(m, side);
  std::vector<std::size_t> others;
  double num_inliers = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (on_side[i] || !(m.weight[i] > 0.0)) continue;
    others.push_back(i);
    num_inliers += answer.inlier[i];
  }
  const double inlier_share = num_inliers / static_cast<double>(others.size());
  const double share = std::max(kHalfOfInliers * inlier_share, kLeastSearched);
  Random random(seed);
  const RivalSearchResult found = search_among(m, std::move(others), share, options, priors,
                                               answer.threshold, kMostSamples, random);
  return !found.poses.empty() &&
         direction_angle(found.poses.front().t, answer.cam2_from_cam1.t) > kMayContradict;
}

// Whether the other inliers of a pose moved the way that it says: where only what is on the side
// moves, as many go the opposite way.
bool signs_agree(const MatchesLeft& left, const RobustResult& all) {
  const RelativePose& pose = all.cam2_from_cam1;
  double along = 0.0, count = 0.0;
  for (std::size_t k = 0; k < left.m.size; ++k) {
    if (!all.inlier[left.rows[k]]) continue;
    const Eigen::Vector3d turned = pose.R * view1(left.m, k);
    const double moved = (view2(left.m, k) - turned).dot(pose.t - pose.t.dot(turned) * turned);
    along += moved > 0.0 ? 1.0 : -1.0;
    count += 1.0;
  }
  const double deviations = along / std::sqrt(std::max(count, 1.0));
  return deviations > kSignsAgree || (deviations > kFewSignsAgree && along > kMostSigns * count);
}

// The turn that an answer says, be it that of a part, which is then its first alternative.
const RelativePose* turn_of(const RobustResult& answer) {
  if (answer.verdict.status == Status::kPureRotation) return &answer.cam2_from_cam1;
  if (answer.verdict.status != Status::kConcentratedInliers) return nullptr;
  return turned_in_part(answer.evidence) ? &answer.alternatives.front() : nullptr;
}

bool turn_contradicts(const Matches& m, const std::vector<std::size_t>& side,
                      const MatchesLeft& left, const std::vector<std::size_t>& agreeing,
                      const RelativePose& turn, const RobustResult& others,
                      const RobustResult& all) {
  // What is fixed to the camera says that it has not even turned.
  std::size_t num_fixed = 0;
  for (const std::size_t k : standing_still(left.m, others.threshold)) {
    num_fixed += others.inlier[k];
  }
  if (2 * num_fixed > agreeing.size()) return false;
  if (signs_agree(left, all)) return false;
  std::vector<double> moved, still;
  for (const std::size_t i : side) {
    moved.push_back(squared_parallax(m, turn, i));
  }
  for (const std::size_t k : agreeing) {
    still.push_back(squared_parallax(left.m, turn, k));
  }
  return value_at(std::move(moved), 0.5) >
         kCannotStandStill * kCannotStandStill * value_at(std::move(still), 0.9);
}

std::vector<std::size_t> inliers_of(const RobustResult& answer) {
  std::vector<std::size_t> inliers;
  for (std::size_t i = 0; i < answer.inlier.size(); ++i) {
    if (answer.inlier[i]) inliers.push_back(i);
  }
  return inliers;
}

}  // namespace

std::vector<std::vector<std::size_t>> sides_that_say_most(
    const Matches& m, Residual residual, const RelativePose& pose,
    const std::vector<unsigned char>& inlier) {
  const SideCells cells = cells_of_inliers(m, residual, pose, inlier);
  const double usual = largest_usual_variance(cells);
  std::vector<std::vector<std::size_t>> sides;
  if (!may_say_most(cells, kSides.back(), usual)) return sides;
  for (const double angle : kSides) {
    const SideCell* middle = side_that_says_most(cells, angle, usual);
    if (!middle) continue;
    std::vector<std::size_t> side = moved_on_side(m, pose, inlier, cells, *middle, angle);
    if (side.size() < kFewestOnSide) continue;
    const std::vector<unsigned char> on_side = mask_of(m, side);
    std::vector<std::size_t> others;
    for (std::size_t i = 0; i < m.size; ++i) {
      if (inlier[i] && !on_side[i]) others.push_back(i);
    }
    if (are_all_around(m, others)) sides.push_back(std::move(side));
  }
  return sides;
}

std::vector<Side> sides_to_ask(const Matches& m, const RobustOptions& options,
                               const MatchPriors& priors, std::uint64_t seed,
                               const RobustResult& answer) {
  std::vector<Side> asked;
  for (std::vector<std::size_t>& side :
       sides_that_say_most(m, options.residual, answer.cam2_from_cam1, answer.inlier)) {
    if (!may_contradict(m, options, priors, seed, answer, side)) continue;
    asked.push_back({std::move(side), false});
    break;
  }
  if (covers_little(answer.evidence)) asked.push_back({inliers_of(answer), true});
  return asked;
}

RobustOptions options_beside(const Side& side, const RobustOptions& options) {
  return side.is_all ? with_most_samples(options, kMostBesideAll) : options;
}

bool contradicts(const Matches& m, const Side& side, const MatchesLeft& left,
                 const RobustResult& others, const RobustResult& all) {
  const std::vector<std::size_t> agreeing = inliers_of(others);
  if (!are_all_around(left.m, agreeing)) return false;
  const auto least = kLeastBesideAll * static_cast<double>(side.rows.size());
  if (side.is_all && static_cast<double>(agreeing.size()) < least) return false;
  if (const RelativePose* turn = turn_of(others)) {
    return turn_contradicts(m, side.rows, left, agreeing, *turn, others, all);
  }
  if (!has_translation(others.verdict.status)) return false;
  // All inliers may lie on one large thing, which has as many regions as it likes.
  if (!side.is_all && others.evidence.num_regions < kLeastRegions * all.evidence.num_regions) {
    return false;
  }
  const double sigma =
      std::hypot(direction_sigma(others.covariance), direction_sigma(all.covariance));
  const auto apart = [&](const RelativePose& pose) {
    return direction_angle(pose.t, all.cam2_from_cam1.t);
  };
  return apart(others.cam2_from_cam1) > std::max(kContradicts, kDeviationsApart * sigma) &&
         std::all_of(others.alternatives.begin(), others.alternatives.end(),
                     [&](const RelativePose& pose) { return apart(pose) > kContradicts; });
}

}  // namespace epi360
