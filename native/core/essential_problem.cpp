// SPDX-License-Identifier: BSD-3-Clause
#include "essential_problem.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "eight_point.h"
#include "essential.h"
#include "five_point.h"
#include "mixture.h"
#include "upright.h"

namespace epi360 {
namespace {

constexpr double kDegree = 0.017453292519943295;
constexpr int kLocalIterations = 8;
// A hypothesis is polished when its support is at least this share of the best one's.
constexpr double kCompetitive = 0.5;
constexpr double kFewestOrdered =
    30.0;  // best scored matches whose share of inliers means something
// Steps at which a candidate counts as converged, in standard deviations of its pose.
constexpr double kFinal = 1e-4;
// Akaike's criterion: what three shares of wider Gaussians must add to the log-likelihood.
constexpr double kSimpler = 3.0;
constexpr double kAnnealFrom = 2.0 * kDegree;
// Hypotheses closer than this share one place in the pool. Local minima of real pairs lie 1 degree
// apart, so they must not.
constexpr double kSameRotation = 0.7 * kDegree, kSameDirection = 2.0 * kDegree;

// The sample's bearings, row-major as the solvers want them.
template <int N>
struct Sample {
  Eigen::Matrix<double, 3, N> b1, b2;
  Sample(const Matches& m, const std::uint32_t* indices) {
    for (int k = 0; k < N; ++k) {
      const std::uint32_t i = indices[k];
      b1.col(k) << m.x1[i], m.y1[i], m.z1[i];
      b2.col(k) << m.x2[i], m.y2[i], m.z2[i];
    }
  }
};

// Appends R with t or -t where the whole sample lies in front of both cameras: most wrong
// hypotheses end here, before any scoring. Turning t round changes the sign of both depths.
template <int N>
int append_signs(const Eigen::Matrix3d& R, const Eigen::Vector3d& t, const Sample<N>& sample,
                 double tolerance, RelativePose* models) {
  bool ahead = true, behind = true;
  for (int k = 0; k < N && (ahead || behind); ++k) {
    const DepthMargins d = depth_margins({R, t}, sample.b1.col(k), sample.b2.col(k));
    ahead = ahead && d.first > -tolerance && d.second > -tolerance;
    behind = behind && d.first < tolerance && d.second < tolerance;
  }
  int count = 0;
  if (ahead) models[count++] = {R, t};
  if (behind) models[count++] = {R, -t};
  return count;
}

template <int N>
int append_poses(const Eigen::Matrix3d& E, const Sample<N>& sample, double tolerance,
                 RelativePose* models) {
  const EssentialFactors f = factors_of(E);
  const int count = append_signs<N>(f.R[0], f.t, sample, tolerance, models);
  return count + append_signs<N>(f.R[1], f.t, sample, tolerance, models + count);
}

}  // namespace

double gate_of(const LossModel& mixture) {
  double low = 2.0, high = 4.0;
  for (int step = 0; step < 20; ++step) {
    const double middle = 0.5 * (low + high), r = middle * mixture.scale;
    const MixtureParts p = mixture_parts(r * r, mixture);
    (p.gaussian[0] > 0.5 * p.total() ? low : high) = middle;
  }
  return low * mixture.scale;
}

bool same_pose(const RelativePose& a, const RelativePose& b, double rotation_rad,
               double direction_rad) {
  return rotation_angle(a.R, b.R) < rotation_rad && direction_angle(a.t, b.t) < direction_rad;
}

EssentialProblem::EssentialProblem(const Matches& m, Residual residual, int sample_size,
                                   double outlier_density)
    : m_(m), residual_(residual), sample_size_(sample_size), outlier_density_(outlier_density) {
  workspace_.resize(m.padded);
}

void EssentialProblem::use_gravity(const Eigen::Vector3d& gravity1,
                                   const Eigen::Vector3d& gravity2) {
  sample_size_ = 3;
  upright1_ = upright_from(gravity1);
  upright2_ = upright_from(gravity2);
}

void EssentialProblem::set_gates(std::vector<double> gates) {
  gates_ = std::move(gates);
  for (Hypothesis& h : pool_) {  // not by score(), which changes the pool
    h.score =
        truncated_score(m_, residual_, plain(h.pose), gates_.data(),
                        static_cast<int>(gates_.size()), std::numeric_limits<double>::infinity());
  }
  std::sort(pool_.begin(), pool_.end(),
            [](const Hypothesis& a, const Hypothesis& b) { return a.score < b.score; });
}

int EssentialProblem::generate(const std::uint32_t* indices, RelativePose* models) {
  if (sample_size_ == 8) {
    const Sample<8> sample(m_, indices);
    Eigen::Matrix3d E;
    if (!eight_point_minimal(sample.b1, sample.b2, &E)) return 0;
    return append_poses<8>(project_to_essential(E), sample, sample_tolerance(), models);
  }
  if (sample_size_ == 3) {
    const Sample<3> sample(m_, indices);
    RelativePose poses[4];
    const int num = upright_three_point(sample.b1, sample.b2, upright1_, upright2_, poses);
    int count = 0;
    for (int k = 0; k < num; ++k) {
      count += append_signs<3>(poses[k].R, poses[k].t, sample, sample_tolerance(), models + count);
    }
    return count;
  }
  const Sample<5> sample(m_, indices);
  Eigen::Matrix<double, 3, 3, Eigen::RowMajor> essentials[10];
  const int num = five_point(sample.b1.data(), sample.b2.data(), essentials[0].data());
  int count = 0;
  for (int k = 0; k < num && count + 4 <= kMaxModels; ++k) {
    count += append_poses<5>(essentials[k], sample, sample_tolerance(), models + count);
  }
  return count;
}

double EssentialProblem::score(const RelativePose& pose, double limit) {
  const double worst =
      pool_.size() < kPoolSize ? std::numeric_limits<double>::infinity() : pool_.back().score;
  const double value = truncated_score(m_, residual_, plain(pose), gates_.data(),
                                       static_cast<int>(gates_.size()), std::max(limit, worst));
  if (value < worst) keep(pose, value);
  return value;
}

void EssentialProblem::keep(RelativePose pose, double score) {
  for (std::size_t k = 0; k < pool_.size(); ++k) {
    if (!same_pose(pool_[k].pose, pose, kSameRotation, kSameDirection)) continue;
    if (pool_[k].score <= score) return;
    pool_.erase(pool_.begin() + static_cast<std::ptrdiff_t>(k));
    break;
  }
  const auto place =
      std::upper_bound(pool_.begin(), pool_.end(), score,
                       [](double value, const Hypothesis& h) { return value < h.score; });
  pool_.insert(place, {pose, score, false});
  if (pool_.size() > kPoolSize) pool_.pop_back();
}

LossModel EssentialProblem::mixture_at(const RelativePose& pose) {
  compute_residuals(m_, residual_, plain(pose), sample_tolerance(),
                    workspace_.current.residuals.data(), workspace_.current.front.data());
  return fit_mixture(m_, workspace_.current.residuals.data(), workspace_.current.front.data(),
                     outlier_density_, 1e-6);
}

RefineResult EssentialProblem::local(const RelativePose& pose, const LossModel& start,
                                     int max_iterations, double sigma_tolerance, bool use_depths) {
  RefineOptions options;
  options.residual = residual_;
  options.loss = start;
  options.use_depths = use_depths;
  options.max_iterations = max_iterations;
  options.step_tolerance = 1e-12;
  options.sigma_tolerance = sigma_tolerance;
  return epi360::refine(m_, pose, options, workspace_);
}

Candidate EssentialProblem::polish(const RelativePose& pose, int max_iterations,
                                   double sigma_tolerance, const LossModel* start) {
  const RefineResult refined =
      local(pose, start ? *start : mixture_at(pose), max_iterations, sigma_tolerance);
  const double evidence = scale_evidence(refined.loss) - workspace_.current.objective;
  const Candidate candidate{refined.pose, refined.loss, evidence, evidence, true};
  keep(candidate);
  return candidate;
}

void EssentialProblem::keep(const Candidate& candidate) {
  if (!std::isfinite(candidate.evidence)) return;
  const auto same = std::find_if(candidates_.begin(), candidates_.end(), [&](const Candidate& c) {
    return same_pose(c.pose, candidate.pose, 0.3 * kSameRotation, 0.3 * kSameDirection);
  });
  if (same == candidates_.end()) {
    candidates_.push_back(candidate);
  } else if (same->evidence < candidate.evidence) {
    *same = candidate;
  }
  std::stable_sort(candidates_.begin(), candidates_.end(),
                   [](const Candidate& a, const Candidate& b) { return a.evidence > b.evidence; });
  if (candidates_.size() > 2 * kPoolSize) candidates_.pop_back();
}

void EssentialProblem::anneal() {
  if (candidates_.empty()) return;
  const Candidate start = candidates_.front();
  RefineOptions options;
  options.residual = residual_;
  options.loss.loss = Loss::kGemanMcClure;
  options.use_depths = true;
  options.max_iterations = 2;
  options.step_tolerance = 1e-7;
  RelativePose pose = start.pose;
  const double last = std::max(2.0 * start.loss.scale, 1e-4);
  for (double scale = std::max(kAnnealFrom, 2.0 * last); scale > last; scale *= 0.5) {
    options.loss.scale = scale;
    pose = epi360::refine(m_, pose, options, workspace_).pose;
  }
  if (!same_pose(pose, start.pose, 0.05 * kSameRotation, 0.05 * kSameDirection)) polish(pose, 25);
}

void EssentialProblem::finish(const std::vector<Candidate>& candidates, double range) {
  const std::vector<Candidate> chosen = candidates;  // polish changes candidates_
  for (const Candidate& c : chosen) {
    if (c.evidence > chosen.front().evidence - range) polish(c.pose, 50, kFinal, &c.loss);
  }
}

Candidate EssentialProblem::without_depths(const Candidate& start) {
  const RefineResult refined = local(start.pose, start.loss, 30, 1e-1, false);
  return {refined.pose, refined.loss, scale_evidence(refined.loss) - workspace_.current.objective};
}

void EssentialProblem::simplify() {
  if (candidates_.empty()) return;
  Candidate& best = candidates_.front();
  LossModel simple = best.loss;
  simple.share[0] = std::min(simple.share[0] + simple.share[1], 0.999);
  for (int k = 1; k < LossModel::kGaussians; ++k) simple.share[k] = 0.0;  // they stay at zero
  const RefineResult refined = local(best.pose, simple, 50, kFinal, best.uses_depths);
  const double log_likelihood = -workspace_.current.objective;
  if (log_likelihood < best.own_evidence - scale_evidence(best.loss) - kSimpler) return;
  best.pose = refined.pose;
  best.loss = refined.loss;
}

void EssentialProblem::polish_pool(int max_iterations) {
  if (pool_.empty()) return;
  const double total = std::accumulate(m_.weight.begin(), m_.weight.end(), 0.0);
  const double needed = kCompetitive * (total - pool_.front().score);
  for (Hypothesis& h : pool_) {
    if (h.polished || total - h.score < needed) continue;
    h.polished = true;
    // A few steps tell whether it leads to a candidate that is known.
    if (is_known(h.pose, 1.0)) continue;
    const LossModel start = mixture_at(h.pose);
    const RefineResult near = local(h.pose, start, 3);
    if (!is_known(near.pose, 0.5)) polish(near.pose, max_iterations, 1e-2, &near.loss);
  }
}

bool EssentialProblem::is_known(const RelativePose& pose, double reach) const {
  return std::any_of(candidates_.begin(), candidates_.end(), [&](const Candidate& c) {
    return same_pose(c.pose, pose, reach * kSameRotation, reach * kSameDirection);
  });
}

void EssentialProblem::refine(RelativePose& pose, double& best) {
  const Candidate candidate = polish(pose, kLocalIterations);
  const double value = score(candidate.pose, best);
  if (value >= best) return;
  pose = candidate.pose;
  best = value;
}

int EssentialProblem::needed(const RelativePose& pose, const LoopOptions& options,
                             const Sampler& sampler) {
  // The pose comes from a local optimisation, which knows its mixture.
  const auto known = std::find_if(candidates_.begin(), candidates_.end(), [&](const Candidate& c) {
    return c.pose.R == pose.R && c.pose.t == pose.t;
  });
  if (known != candidates_.end()) {
    compute_residuals(m_, residual_, plain(pose), sample_tolerance(),
                      workspace_.current.residuals.data(), workspace_.current.front.data());
  }
  const LossModel mixture = known != candidates_.end() ? known->loss : mixture_at(pose);
  const double gate = gates_.size() == 1 ? gates_.front() : gate_of(mixture);
  double inliers = 0.0, total = 0.0, best = 0.0;
  for (std::size_t i = 0; i < m_.size; ++i) {
    if (m_.weight[i] > 0.0) {
      total += 1.0;
      inliers +=
          workspace_.current.front[i] > 0.5 && std::abs(workspace_.current.residuals[i]) < gate;
    }
    // Progressive samples came from the first matches only: they may stop as soon as those say so.
    const bool considered = sampler.progressive() && i + 1 >= sampler.reached();
    if (considered && total >= kFewestOrdered) best = std::max(best, inliers / total);
  }
  if (total > 0.0) best = std::max(best, inliers / total);
  return iterations_needed(best, sample_size_, options);
}

}  // namespace epi360
