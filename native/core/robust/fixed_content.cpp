// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/fixed_content.h"

#include <algorithm>
#include <cmath>

#include "core/bearings.h"
#include "core/constants.h"
#include "core/residuals/residuals.h"
#include "core/robust/evidence.h"

namespace epi360 {
namespace {

constexpr double kFixed = 1.0 * kDegree;  // of what stands still, if stitched or bent
constexpr double kSurrounds = 1.5;
// Of two poses that explain the matches about equally well, one may be that of matches that stand
// still: so many times these are at least as many as the inliers of the other.
constexpr double kCompeting = 4.0;
// The others are asked if they are at least a fifth as many as those that stand still.
constexpr double kFewestBeside = 0.2;
// Share of the others that must agree with their answer, which is believed by itself, beside a
// camera that seems to stand still; and where two poses compete, as beside a tripod that two rooms
// show.
constexpr double kLeastBesideStill = 0.25, kLeastBesidePoses = 0.5;

// Whether some matches lie around the camera, and others in a smaller part of what it sees. A pole
// is a corner of many cells, and two poles have no mean bearing: either measure will do.
bool surround(const Extent& some, const Extent& others) {
  return some.spread > kSurrounds * others.spread || some.coverage > kSurrounds * others.coverage;
}

}  // namespace

std::vector<std::size_t> standing_still(const Matches& m, double gate) {
  const double tolerance = std::max(gate, kFixed);
  std::vector<std::size_t> still;
  for (std::size_t i = 0; i < m.size; ++i) {
    if ((view1(m, i) - view2(m, i)).norm() < tolerance) still.push_back(i);
  }
  return still;
}

std::vector<std::size_t> maybe_fixed(const Matches& m, const RobustResult& answer) {
  if (answer.verdict.status == Status::kOk) return {};
  std::vector<std::size_t> still = standing_still(m, answer.threshold);
  std::size_t agreeing = 0, num_inliers = 0;
  for (const std::size_t i : still) agreeing += answer.inlier[i];
  for (const unsigned char each : answer.inlier) num_inliers += each;
  const bool is_answer = agreeing > 0 && 2 * agreeing >= num_inliers;
  const bool is_rival = answer.verdict.status == Status::kPlanarAmbiguous &&
                        kCompeting * static_cast<double>(still.size()) >= num_inliers;
  if (!is_answer && !is_rival) return {};
  const std::vector<unsigned char> fixed = mask_of(m, still);
  std::vector<unsigned char> others(m.size);
  std::transform(fixed.begin(), fixed.end(), others.begin(), [](auto each) { return !each; });
  const Extent where = extents(m, fixed.data()).chosen;
  const bool may_count = surround(extents(m, others.data()).chosen, where);
  // Of a camera that only turned, what all around it says otherwise is worth a warning.
  const bool may_warn = answer.verdict.status == Status::kPureRotation &&
                        kFewestBeside * static_cast<double>(still.size()) <= m.size - still.size();
  return may_count || may_warn ? still : std::vector<std::size_t>{};
}

OthersSay others_say(const Matches& m, const std::vector<std::size_t>& fixed,
                     const MatchesLeft& left, const RobustResult& first, const RobustResult& answer,
                     Residual residual) {
  const Status status = answer.verdict.status;
  if (status != Status::kOk && status != Status::kPureRotation) return OthersSay::kNothing;
  const Matches still = chosen_matches(m, fixed);
  const std::vector<double> residuals = residuals_under(answer, still, residual);
  std::size_t moved = 0;
  for (std::size_t i = 0; i < still.size; ++i)
    moved += !(std::abs(residuals[i]) < answer.threshold);
  if (2 * moved <= still.size) return OthersSay::kNothing;
  const auto agreeing = std::count(answer.inlier.begin(), answer.inlier.end(), 1);
  const bool has_stood = first.verdict.status == Status::kPureRotation;
  const double least =
      (has_stood ? kLeastBesideStill : kLeastBesidePoses) * static_cast<double>(left.m.size);
  if (static_cast<double>(agreeing) <= least) return OthersSay::kNothing;
  const Extent where = extents(m, mask_of(m, fixed).data()).chosen;
  if (surround(extents(left.m, answer.inlier.data()).chosen, where)) return OthersSay::kFixed;
  return status == Status::kOk ? OthersSay::kPose : OthersSay::kNothing;
}

}  // namespace epi360
