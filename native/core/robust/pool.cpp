// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/pool.h"

#include <algorithm>
#include <cstddef>
#include <limits>

namespace epi360 {

double HypothesisPool::worst() const {
  return hypotheses_.size() < kSize ? std::numeric_limits<double>::infinity()
                                    : hypotheses_.back().score;
}

void HypothesisPool::offer(const RelativePose& cam2_from_cam1, double score) {
  if (!(score < worst())) return;
  for (std::size_t k = 0; k < hypotheses_.size(); ++k) {
    const Hypothesis& known = hypotheses_[k];
    if (!same_pose(known.cam2_from_cam1, cam2_from_cam1, kSameRotation, kSameDirection)) continue;
    if (known.score <= score) return;
    hypotheses_.erase(hypotheses_.begin() + static_cast<std::ptrdiff_t>(k));
    break;
  }
  const auto place =
      std::upper_bound(hypotheses_.begin(), hypotheses_.end(), score,
                       [](double value, const Hypothesis& h) { return value < h.score; });
  hypotheses_.insert(place, {cam2_from_cam1, score, false});
  if (hypotheses_.size() > kSize) hypotheses_.pop_back();
}

void HypothesisPool::sort() {
  std::sort(hypotheses_.begin(), hypotheses_.end(),
            [](const Hypothesis& a, const Hypothesis& b) { return a.score < b.score; });
}

}  // namespace epi360
