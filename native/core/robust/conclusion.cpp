// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/conclusion.h"

#include <cmath>

#include "core/bearings.h"
#include "core/residuals/residuals.h"
#include "core/robust/copies.h"
#include "core/robust/derivative_noise.h"
#include "core/robust/evidence.h"

namespace epi360 {
namespace {

// The numbers that this status leaves undetermined become NaN.
void clear_undetermined(Status status, RelativePose& cam2_from_cam1) {
  if (has_translation(status)) return;
  cam2_from_cam1.t.setConstant(RobustResult::kNaN);
  if (status != Status::kPureRotation) cam2_from_cam1.R.setConstant(RobustResult::kNaN);
}

}  // namespace

void conclude(const Matches& m, const RobustOptions& options, const RowCounts& rows,
              double max_noise, RobustResult& r) {
  Evidence& evidence = r.evidence;
  evidence.num_matches = static_cast<int>(rows.given);
  evidence.num_copies = static_cast<int>(rows.copies);
  evidence.min_num_inliers = options.min_num_inliers;
  evidence.num_distinct = count_distinct(m, r.inlier.data(), options.min_num_inliers);
  const Extents where = extents(m, r.inlier.data());
  evidence.spread = where.chosen.spread;
  evidence.spread_of_matches = where.all.spread;
  evidence.coverage = where.chosen.coverage;
  evidence.match_coverage = where.all.coverage;
  const bool is_rotation = std::isnan(r.probability);  // its residuals are the noise
  evidence.noise = r.scale * (is_rotation ? 1.0 : noise_per_residual(options.residual));
  evidence.max_noise = max_noise;
  if (!is_rotation) r.probability = probability_of_pose(evidence);
  r.verdict = judge(evidence);
  const Status status = r.verdict.status;
  if (is_rotation && status != Status::kPureRotation) r.probability = 0.0;  // no pose was found
  r.translation_basis.setConstant(RobustResult::kNaN);
  if (has_translation(status)) r.translation_basis = tangent_basis(r.cam2_from_cam1.t);
  if (!has_translation(status) && status != Status::kPureRotation) {
    r.covariance.setConstant(RobustResult::kNaN);
  }
  if (status == Status::kTooFewInliers) {
    r.alternatives.clear();
    if (is_worth_a_look(evidence)) r.alternatives = {r.cam2_from_cam1};
  }
  if (status == Status::kConcentratedInliers) {  // what it would have been
    r.alternatives.insert(r.alternatives.begin(), r.cam2_from_cam1);
    if (is_rotation) r.alternatives.front().t.setConstant(RobustResult::kNaN);
  }
  clear_undetermined(status, r.cam2_from_cam1);
}

}  // namespace epi360
