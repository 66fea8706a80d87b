// SPDX-License-Identifier: BSD-3-Clause
// Refined hypotheses, the most likely first, and what refines them.
#pragma once

#include <algorithm>
#include <limits>
#include <vector>

#include "core/matches.h"
#include "core/refinement/refine.h"
#include "core/robust/pool.h"

namespace epi360 {

// A refined hypothesis with its mixture; comparable across scales by the evidence: log-likelihood
// of all matches plus scale_evidence.
struct Candidate {
  RelativePose cam2_from_cam1;
  LossModel loss;
  double evidence = -std::numeric_limits<double>::infinity();
  // That of this very pose with depths, if it is known; `evidence` ranks it among the others.
  double own_evidence = -std::numeric_limits<double>::infinity();
};

class Candidates {
 public:
  Candidates(const Matches& m, Residual residual, const PosePrior& prior = {});

  // Parallax of the wrong sign (radians) that a match may show under a pose not yet refined.
  void set_depth_tolerance(double tolerance) { depth_tolerance_ = tolerance; }

  double depth_tolerance() const { return depth_tolerance_; }

  // The most likely mixture at a pose: the one it was refined with, or a fit to its residuals.
  // `linearisation` then holds the residuals and depths.
  LossModel mixture_at(const RelativePose& cam2_from_cam1);
  const Linearisation& linearisation() const { return workspace_.current; }

  // Maximum-likelihood pose under the mixture, its scale and shares estimated; where they start is
  // fitted to the residuals unless a mixture is given.
  Candidate polish(const RelativePose& cam2_from_cam1, int max_iterations,
                   double sigma_tolerance = 1e-2, const LossModel* start = nullptr);
  // Polishes those of a pool that may compete with its best.
  void polish_pool(HypothesisPool& pool, int max_iterations);
  // Polishes the best candidate once more from far away (graduated non-convexity): the wide loss
  // forgets the local minimum, the narrowing one finds the deepest near by.
  void anneal();
  RelativePose annealed(RelativePose pose, double narrowest);
  // The optimum of the residuals alone near a candidate, and its evidence without depths.
  Candidate without_depths(const Candidate& start);
  void replace_best(const Candidate& candidate) { candidates_.front() = candidate; }
  // Adds a candidate of the same matches behind those that are more likely, and behind one that was
  // put first; false if it is the first one, or known with about as much evidence.
  bool add(const Candidate& candidate);
  // Puts one of them first, whatever its evidence.
  void prefer(std::size_t index);
  // The same of the one that is the same optimum as another candidate; false if that is the first,
  // or not among them.
  bool prefer(const Candidate& candidate);
  // Refines the best candidate once more, so that a match behind a camera may be a near miss, and
  // takes that pose where it makes the matches much more likely. What moves far away (clouds,
  // traffic) lies behind the cameras by degrees under the right pose; if it can only be outliers,
  // a wrong pose with more noise, which has it in front, becomes the likelier one.
  void allow_near_misses();
  // Gives the best candidate up for the pose under one Gaussian and the uniform part where the
  // wider Gaussians explain nothing: they would cost a tenth of the accuracy.
  void simplify();
  // Gives the best candidate up, and the next one again, where a sharper one has clearly more
  // log-odds over chance (displacement.h): its noise is so large that it explains wrong matches
  // too.
  void give_up_blurred();
  // Polishes blurred rivals of a candidate with its mixture: they may be as sharp as it is.
  void sharpen(const Candidate& over);
  // Evidence by which a candidate leads another one; or the log-odds over chance, if it has more
  // noise and they are less.
  double lead(const Candidate& candidate, const Candidate& over);
  // Polishes candidates whose log-evidence is at most `range` below the best one's to the end.
  void finish(const std::vector<Candidate>& candidates, double range);

  RefineWorkspace& workspace() { return workspace_; }  // for refinements of others
  const PosePrior& prior() const { return prior_; }
  bool empty() const { return candidates_.empty(); }
  const Candidate& best() const { return candidates_.front(); }
  const std::vector<Candidate>& all() const { return candidates_; }  // descending evidence

 private:
  LossModel fitted_mixture(const RelativePose& cam2_from_cam1);
  void compute_residuals_at(const RelativePose& cam2_from_cam1);
  RefineResult local(const RelativePose& cam2_from_cam1, const LossModel& start, int max_iterations,
                     double sigma_tolerance = 1e-2, Behind behind = Behind::kOutlier);
  // Whether the matches that agree with a pose, at which the workspace is, show more than noise.
  bool has_parallax(const RefineResult& at) const;
  bool is_known(const RelativePose& cam2_from_cam1, double reach) const;
  double log_odds(const Candidate& candidate);
  // The one that is the same optimum.
  std::vector<Candidate>::iterator same_as(const Candidate& candidate);
  void keep(const Candidate& candidate);

  const Matches& m_;
  Residual residual_;
  PosePrior prior_;
  double depth_tolerance_ = 0.0;
  double outlier_density_;
  std::vector<double> displaced_;  // empty until they are asked for
  std::vector<Candidate> candidates_;
  RefineWorkspace workspace_;
};

// Whether one mixture has clearly less noise than another: with more, a pose between two motions
// explains parts of both.
bool is_sharper(const LossModel& one, const LossModel& other);

// Residual at which an inlier and an outlier are equally likely, within [2, 4] standard deviations.
double gate_of(const LossModel& mixture);

}  // namespace epi360
