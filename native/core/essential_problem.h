// SPDX-License-Identifier: BSD-3-Clause
// The relative-pose problem for the RANSAC loop, and the pool of its best distinct hypotheses.
#pragma once

#include <limits>
#include <vector>

#include "matches.h"
#include "ransac.h"
#include "refine.h"

namespace epi360 {

struct Hypothesis {
  RelativePose pose;
  double score;
  bool polished;
};

// A refined hypothesis with its mixture; comparable across scales by the evidence: log-likelihood
// of all matches plus scale_evidence.
struct Candidate {
  RelativePose pose;
  LossModel loss;
  double evidence = -std::numeric_limits<double>::infinity();
  // Of this very pose, with or without depths; `evidence` ranks it among the others.
  double own_evidence = -std::numeric_limits<double>::infinity();
  bool uses_depths = true;
};

class EssentialProblem {
 public:
  using Model = RelativePose;
  static constexpr int kMaxModels = 20;  // ten essential matrices, rarely two poses each
  static constexpr std::size_t kPoolSize = 12;

  EssentialProblem(const Matches& m, Residual residual, int sample_size, double outlier_density);

  // Samples of three matches instead, with the directions of gravity in both cameras.
  void use_gravity(const Eigen::Vector3d& gravity1, const Eigen::Vector3d& gravity2);

  // The gates of the truncated score, radians. Rescores the pool.
  void set_gates(std::vector<double> gates);

  std::uint32_t num_matches() const { return static_cast<std::uint32_t>(m_.size); }
  int sample_size() const { return sample_size_; }
  int generate(const std::uint32_t* sample, RelativePose* models);
  double score(const RelativePose& pose, double limit);
  void refine(RelativePose& pose, double& score);
  int needed(const RelativePose& pose, const LoopOptions& options, const Sampler& sampler);

  // Residuals, depths and the most likely mixture at a pose.
  LossModel mixture_at(const RelativePose& pose);
  // Maximum-likelihood pose under the mixture, its scale and shares estimated; where they start is
  // fitted to the residuals unless a mixture is given.
  Candidate polish(const RelativePose& pose, int max_iterations, double sigma_tolerance = 1e-2,
                   const LossModel* start = nullptr);
  void polish_pool(int max_iterations);
  // Polishes the best candidate once more from far away (graduated non-convexity): the wide loss
  // forgets the local minimum, the narrowing one finds the deepest near by.
  void anneal();
  // The optimum of the residuals alone near a candidate, and its evidence without depths.
  Candidate without_depths(const Candidate& start);
  void replace_best(const Candidate& candidate) { candidates_.front() = candidate; }
  // Gives the best candidate up for the pose under one Gaussian and the uniform part where the
  // wider Gaussians explain nothing: they would cost a tenth of the accuracy.
  void simplify();
  // Polishes candidates whose log-evidence is at most `range` below the best one's to the end.
  void finish(const std::vector<Candidate>& candidates, double range);

  const std::vector<Candidate>& candidates() const { return candidates_; }

 private:
  // Wrong parallax that a sample may show: the middle one of several gates.
  double sample_tolerance() const { return gates_[gates_.size() / 2]; }
  RefineResult local(const RelativePose& pose, const LossModel& start, int max_iterations,
                     double sigma_tolerance = 1e-2, bool use_depths = true);
  bool is_known(const RelativePose& pose, double reach) const;
  void keep(RelativePose pose, double score);
  void keep(const Candidate& candidate);

  const Matches& m_;
  Residual residual_;
  int sample_size_;
  double outlier_density_;
  Eigen::Matrix3d upright1_, upright2_;
  std::vector<double> gates_;
  std::vector<Hypothesis> pool_;       // sampled, ascending score
  std::vector<Candidate> candidates_;  // refined, descending evidence
  RefineWorkspace workspace_;
};

// Residual at which an inlier and an outlier are equally likely, within [2, 4] standard deviations.
double gate_of(const LossModel& mixture);

// Whether two poses are so close that they are one hypothesis.
bool same_pose(const RelativePose& a, const RelativePose& b, double rotation_rad,
               double direction_rad);

}  // namespace epi360
