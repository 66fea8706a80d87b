// SPDX-License-Identifier: BSD-3-Clause
// The best distinct hypotheses that the sampling saw, for refinement later.
#pragma once

#include <vector>

#include "core/constants.h"
#include "core/pose.h"

namespace epi360 {

struct Hypothesis {
  RelativePose cam2_from_cam1;
  double score;
  bool polished;
};

// Hypotheses closer than this share one place. Local minima of real pairs lie 1 degree apart, so
// they must not.
constexpr double kSameRotation = 0.7 * kDegree, kSameDirection = 2.0 * kDegree;

class HypothesisPool {
 public:
  static constexpr std::size_t kSize = 12;

  double worst() const;
  void offer(const RelativePose& cam2_from_cam1, double score);

  // Scores everything anew, by a function of the pose.
  template <typename Score>
  void rescore(const Score& score) {
    for (Hypothesis& h : hypotheses_) h.score = score(h.cam2_from_cam1);
    sort();
  }

  std::vector<Hypothesis>& hypotheses() { return hypotheses_; }  // ascending score

 private:
  void sort();

  std::vector<Hypothesis> hypotheses_;
};

}  // namespace epi360
