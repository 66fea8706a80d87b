// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/candidates.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/refinement/fit_mixture.h"
#include "core/robust/displacement.h"
#include "core/robust/evidence.h"

namespace epi360 {
namespace {

// A hypothesis is polished when its support is at least this share of the best one's.
constexpr double kCompetitive = 0.5;
// Steps at which a candidate counts as converged, in standard deviations of its pose.
constexpr double kFinal = 1e-4;
// Akaike's criterion: what three shares of wider Gaussians must add to the log-likelihood.
constexpr double kSimpler = 3.0;
// Log-likelihood by which near misses among the matches behind a camera must explain more, in all
// and for each match: clouds gain 0.4 to 1.6, random outliers a hundredth. With 0.05, pairs of
// rooms that are copies gained it too, and the check of places in a folder believed them.
constexpr double kNearMisses = 30.0, kNearMissesPerMatch = 0.3;
constexpr double kNews = 1.0;      // log-likelihood that a better fit of a known pose must gain
constexpr double kMajority = 0.5;  // of the matches, which must agree with the pose
// In noise: the median parallax with which the sign of one tells where a point lies.
constexpr double kTellingParallax = 6.0;
constexpr int kProbe = 1;            // steps after which it shows whether they may
constexpr double kProbeGain = 0.3;   // share of that by then
constexpr double kNarrowest = 1e-4;  // radians, of annealing
constexpr double kAnnealFrom = 2.0 * kDegree;
constexpr double kSharper = 1.5;   // times less noise
constexpr double kClearly = 30.0;  // log-odds that a sharper candidate must have more

bool is_sharper(const Candidate& one, const Candidate& other) {
  return is_sharper(one.loss, other.loss);
}

}  // namespace

bool is_sharper(const LossModel& one, const LossModel& other) {
  return kSharper * one.scale < other.scale;
}

double gate_of(const LossModel& mixture) {
  double low = 2.0, high = 4.0;
  for (int step = 0; step < 20; ++step) {
    const double middle = 0.5 * (low + high), r = middle * mixture.scale;
    const MixtureParts p = mixture_parts(r * r, mixture);
    (p.gaussian[0] > 0.5 * p.total() ? low : high) = middle;
  }
  return low * mixture.scale;
}

Candidates::Candidates(const Matches& m, Residual residual, const PosePrior& prior)
    : m_(m), residual_(residual), prior_(prior), outlier_density_(density_in_view(m)) {
  workspace_.resize(m.padded);
}

void Candidates::compute_residuals_at(const RelativePose& pose) {
  compute_residuals(m_, residual_, plain(pose), workspace_.current.residuals.data(),
                    workspace_.current.margins.data());
}

LossModel Candidates::fitted_mixture(const RelativePose& pose) {
  compute_residuals_at(pose);
  return fit_mixture(m_, workspace_.current.residuals.data(), workspace_.current.margins.data(),
                     depth_tolerance_, outlier_density_, m_.least_scale);
}

LossModel Candidates::mixture_at(const RelativePose& pose) {
  const auto known = std::find_if(candidates_.begin(), candidates_.end(), [&](const Candidate& c) {
    return c.cam2_from_cam1.R == pose.R && c.cam2_from_cam1.t == pose.t;
  });
  if (known == candidates_.end()) return fitted_mixture(pose);
  compute_residuals_at(pose);
  return known->loss;
}

RefineResult Candidates::local(const RelativePose& pose, const LossModel& start, int max_iterations,
                               double sigma_tolerance, Behind behind) {
  RefineOptions options;
  options.residual = residual_;
  options.prior = prior_;
  options.loss = start;
  options.loss.outlier_density = outlier_density_;
  options.behind = behind;
  options.smallest_scale = m_.least_scale;
  options.max_iterations = max_iterations;
  options.step_tolerance = 1e-12;
  options.sigma_tolerance = sigma_tolerance;
  return refine(m_, pose, options, workspace_);
}

Candidate Candidates::polish(const RelativePose& pose, int max_iterations, double sigma_tolerance,
                             const LossModel* start) {
  const RefineResult refined =
      local(pose, start ? *start : fitted_mixture(pose), max_iterations, sigma_tolerance);
  const double evidence = scale_evidence(refined.loss) - workspace_.current.objective;
  const Candidate candidate{refined.cam2_from_cam1, refined.loss, evidence, evidence};
  keep(candidate);
  return candidate;
}

std::vector<Candidate>::iterator Candidates::same_as(const Candidate& candidate) {
  return std::find_if(candidates_.begin(), candidates_.end(), [&](const Candidate& c) {
    return same_pose(c.cam2_from_cam1, candidate.cam2_from_cam1, 0.3 * kSameRotation,
                     0.3 * kSameDirection);
  });
}

void Candidates::keep(const Candidate& candidate) {
  if (!std::isfinite(candidate.evidence)) return;
  const auto same = same_as(candidate);
  if (same == candidates_.end()) {
    candidates_.push_back(candidate);
  } else if (same->evidence < candidate.evidence) {
    *same = candidate;
  }
  std::stable_sort(candidates_.begin(), candidates_.end(),
                   [](const Candidate& a, const Candidate& b) { return a.evidence > b.evidence; });
  if (candidates_.size() > 2 * HypothesisPool::kSize) candidates_.pop_back();
}

void Candidates::polish_pool(HypothesisPool& pool, int max_iterations) {
  std::vector<Hypothesis>& hypotheses = pool.hypotheses();
  if (hypotheses.empty()) return;
  const double total = std::accumulate(m_.weight.begin(), m_.weight.end(), 0.0);
  const double needed = kCompetitive * (total - hypotheses.front().score);
  for (Hypothesis& h : hypotheses) {
    if (h.polished || total - h.score < needed) continue;
    h.polished = true;
    // A few steps tell whether it leads to a candidate that is known.
    if (is_known(h.cam2_from_cam1, 1.0)) continue;
    const RefineResult near = local(h.cam2_from_cam1, fitted_mixture(h.cam2_from_cam1), 3);
    if (!is_known(near.cam2_from_cam1, 0.5)) {
      polish(near.cam2_from_cam1, max_iterations, 1e-2, &near.loss);
    }
  }
}

bool Candidates::is_known(const RelativePose& pose, double reach) const {
  return std::any_of(candidates_.begin(), candidates_.end(), [&](const Candidate& c) {
    return same_pose(c.cam2_from_cam1, pose, reach * kSameRotation, reach * kSameDirection);
  });
}

RelativePose Candidates::annealed(RelativePose pose, double narrowest) {
  RefineOptions options;
  options.residual = residual_;
  options.prior = prior_;
  options.loss.loss = Loss::kGemanMcClure;
  options.behind = Behind::kOutlier;
  options.max_iterations = 2;
  options.step_tolerance = 1e-7;
  for (double scale = std::max(kAnnealFrom, 2.0 * narrowest); scale > narrowest; scale *= 0.5) {
    options.loss.scale = scale;
    pose = refine(m_, pose, options, workspace_).cam2_from_cam1;
  }
  return pose;
}

void Candidates::anneal() {
  if (candidates_.empty()) return;
  const Candidate start = candidates_.front();
  const RelativePose pose =
      annealed(start.cam2_from_cam1, std::max(2.0 * start.loss.scale, kNarrowest));
  if (!same_pose(pose, start.cam2_from_cam1, 0.05 * kSameRotation, 0.05 * kSameDirection)) {
    polish(pose, 25);
  }
}

double Candidates::log_odds(const Candidate& candidate) {
  if (displaced_.empty()) displaced_ = displacements(m_);
  compute_residuals_at(candidate.cam2_from_cam1);
  const Linearisation& at = workspace_.current;
  return scale_evidence(candidate.loss) - prior_.cost(candidate.cam2_from_cam1) +
         log_odds_over_chance(m_, displaced_, at.residuals.data(), at.margins.data(),
                              depth_tolerance_, candidate.loss);
}

void Candidates::sharpen(const Candidate& over) {
  const std::vector<Candidate> all = candidates_;  // polish changes candidates_
  for (const Candidate& c : all) {
    if (!is_sharper(over, c) || c.evidence < over.evidence - kClearly) continue;
    polish(c.cam2_from_cam1, 50, kFinal, &over.loss);
  }
}

double Candidates::lead(const Candidate& candidate, const Candidate& over) {
  const double by_evidence = candidate.evidence - over.evidence;
  if (!is_sharper(over, candidate)) return by_evidence;
  return std::min(by_evidence, log_odds(candidate) - log_odds(over));
}

void Candidates::give_up_blurred() {
  const auto is_sharper_than_best = [&](const Candidate& c) { return is_sharper(c, best()); };
  while (std::any_of(candidates_.begin(), candidates_.end(), is_sharper_than_best)) {
    const double enough = log_odds(best()) + kClearly;
    const auto wins = [&](const Candidate& c) {
      return is_sharper_than_best(c) && log_odds(c) > enough;
    };
    if (std::none_of(candidates_.begin(), candidates_.end(), wins)) return;
    candidates_.erase(candidates_.begin());
  }
}

void Candidates::finish(const std::vector<Candidate>& candidates, double range) {
  const std::vector<Candidate> chosen = candidates;  // polish changes candidates_
  for (const Candidate& c : chosen) {
    if (c.evidence > chosen.front().evidence - range) polish(c.cam2_from_cam1, 50, kFinal, &c.loss);
  }
}

Candidate Candidates::without_depths(const Candidate& start) {
  const RefineResult refined = local(start.cam2_from_cam1, start.loss, 30, 1e-1, Behind::kAsOthers);
  return {refined.cam2_from_cam1, refined.loss,
          scale_evidence(refined.loss) - workspace_.current.objective};
}

bool Candidates::has_parallax(const RefineResult& at) const {
  const double gate = gate_of(at.loss);
  std::vector<unsigned char> agrees(m_.size);
  for (std::size_t i = 0; i < m_.size; ++i) {
    agrees[i] = std::abs(workspace_.current.residuals[i]) < gate;
  }
  const double parallax = median_parallax(m_, at.cam2_from_cam1, agrees.data());
  return parallax > kTellingParallax * at.loss.scale;
}

void Candidates::allow_near_misses() {
  if (candidates_.empty()) return;
  Candidate& best = candidates_.front();
  if (!std::isfinite(best.own_evidence)) return;  // found without depths
  // With so much noise the sign of a parallax tells little, and nothing is a near miss by it.
  if (hides_depths(best.loss.scale)) return;
  // Where most matches are wrong, they would decide.
  if (!(best.loss.share[0] + best.loss.share[1] > kMajority)) return;
  const auto refined = [&](const RefineResult& start, int max_iterations, double sigma_tolerance) {
    return local(start.cam2_from_cam1, start.loss, max_iterations, sigma_tolerance,
                 Behind::kNearMiss);
  };
  const auto gain = [&](const RefineResult& result) {
    return scale_evidence(result.loss) - workspace_.current.objective - best.own_evidence;
  };
  const double needed = std::max(
      kNearMisses, kNearMissesPerMatch * std::accumulate(m_.weight.begin(), m_.weight.end(), 0.0));
  RefineResult result;
  result.cam2_from_cam1 = best.cam2_from_cam1;
  result.loss = best.loss;
  result = refined(result, kProbe, 1e-1);  // for most pairs it ends here
  if (!(gain(result) > kProbeGain * needed)) return;
  result = refined(result, 50, kFinal);
  if (!(gain(result) > needed) || !has_parallax(result)) return;
  best.own_evidence += gain(result);  // its rivals are judged without near misses, and so is it
  best.cam2_from_cam1 = result.cam2_from_cam1;
  best.loss = result.loss;
}

bool Candidates::add(const Candidate& candidate) {
  const bool is_chosen =
      candidates_.size() > 1 && candidates_.front().evidence < candidates_[1].evidence;
  const auto same = same_as(candidate);
  if (same == candidates_.begin()) return false;
  bool is_news = true;
  if (same != candidates_.end()) {
    if (candidate.evidence < same->evidence) return false;
    is_news = candidate.evidence >= same->evidence + kNews;
    candidates_.erase(same);
  }
  const auto place =
      std::find_if(candidates_.begin() + is_chosen, candidates_.end(),
                   [&](const Candidate& c) { return c.evidence < candidate.evidence; });
  candidates_.insert(place, candidate);
  return is_news;
}

void Candidates::prefer(std::size_t index) {
  const auto chosen = candidates_.begin() + static_cast<std::ptrdiff_t>(index);
  std::rotate(candidates_.begin(), chosen, chosen + 1);
}

bool Candidates::prefer(const Candidate& candidate) {
  const auto same = same_as(candidate);
  if (same == candidates_.begin() || same == candidates_.end()) return false;
  prefer(static_cast<std::size_t>(same - candidates_.begin()));
  return true;
}

void Candidates::simplify() {
  if (candidates_.empty()) return;
  Candidate& best = candidates_.front();
  LossModel simple = best.loss;
  simple.share[0] = std::min(simple.share[0] + simple.share[1], 0.999);
  for (int k = 1; k < LossModel::kGaussians; ++k) simple.share[k] = 0.0;  // they stay at zero
  const RefineResult refined = local(best.cam2_from_cam1, simple, 50, kFinal);
  const double log_likelihood = -workspace_.current.objective;
  if (log_likelihood < best.own_evidence - scale_evidence(best.loss) - kSimpler) return;
  best.cam2_from_cam1 = refined.cam2_from_cam1;
  best.loss = refined.loss;
}

}  // namespace epi360
