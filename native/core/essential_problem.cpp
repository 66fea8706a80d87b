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

namespace epi360 {
namespace {

constexpr double kDegree = 0.017453292519943295;
constexpr int kLocalIterations = 8;
// A hypothesis is polished when its support is at least this share of the best one's.
constexpr double kCompetitive = 0.5;
constexpr double kAnnealFrom = 2.0 * kDegree;
// Hypotheses closer than this share one place in the pool. Local minima of real pairs lie 1 degree
// apart, so they must not.
constexpr double kSameRotation = 0.7 * kDegree, kSameDirection = 2.0 * kDegree;

template <int N>
void gather(const Matches& m, const std::uint32_t* sample, Eigen::Matrix<double, 3, N>& b1,
            Eigen::Matrix<double, 3, N>& b2) {
  for (int k = 0; k < N; ++k) {
    const std::uint32_t i = sample[k];
    b1.col(k) << m.x1[i], m.y1[i], m.z1[i];
    b2.col(k) << m.x2[i], m.y2[i], m.z2[i];
  }
}

// Appends the poses of E for which the whole sample lies in front of both cameras: most wrong
// hypotheses end here, before any scoring.
template <int N>
int append_poses(const Eigen::Matrix3d& E, const Eigen::Matrix<double, 3, N>& b1,
                 const Eigen::Matrix<double, 3, N>& b2, double tolerance, RelativePose* models) {
  int count = 0;
  for (const RelativePose& pose : decompose_essential(E)) {
    bool all = true;
    for (int k = 0; k < N && all; ++k) all = in_front(pose, b1.col(k), b2.col(k), tolerance);
    if (all) models[count++] = pose;
  }
  return count;
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

void EssentialProblem::set_gates(std::vector<double> gates) {
  gates_ = std::move(gates);
  for (Hypothesis& h : pool_) h.score = score(h.pose, std::numeric_limits<double>::infinity());
  std::sort(pool_.begin(), pool_.end(),
            [](const Hypothesis& a, const Hypothesis& b) { return a.score < b.score; });
}

int EssentialProblem::generate(const std::uint32_t* sample, RelativePose* models) {
  int count = 0;
  if (sample_size_ == 8) {
    Eigen::Matrix<double, 3, 8> b1, b2;
    gather<8>(m_, sample, b1, b2);
    Eigen::Matrix3d E;
    if (!eight_point_minimal(b1, b2, &E)) return 0;
    return append_poses<8>(project_to_essential(E), b1, b2, sample_tolerance(), models);
  }
  Eigen::Matrix<double, 3, 5> b1, b2;
  gather<5>(m_, sample, b1, b2);
  Eigen::Matrix3d essentials[10];
  const int num = five_point(b1, b2, essentials);
  for (int k = 0; k < num && count + 4 <= kMaxModels; ++k) {
    count += append_poses<5>(essentials[k], b1, b2, sample_tolerance(), models + count);
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

void EssentialProblem::keep(const RelativePose& pose, double score) {
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
  compute_residuals(m_, residual_, plain(pose), sample_tolerance(), workspace_.residuals.data(),
                    workspace_.front.data());
  return fit_mixture(m_, workspace_.residuals.data(), workspace_.front.data(), outlier_density_,
                     1e-6);
}

Candidate EssentialProblem::polish(const RelativePose& pose, int max_iterations,
                                   double step_tolerance) {
  RefineOptions options;
  options.residual = residual_;
  options.loss = mixture_at(pose);
  options.use_depths = true;
  options.max_iterations = max_iterations;
  options.step_tolerance = step_tolerance;
  const RefineResult refined = epi360::refine(m_, pose, options, workspace_);
  Candidate candidate{refined.pose, refined.loss, scale_evidence(refined.loss)};
  compute_residuals(m_, residual_, plain(refined.pose), depth_tolerance(refined.loss.scale),
                    workspace_.residuals.data(), workspace_.front.data());
  const MixturePass pass{m_.padded, workspace_.residuals.data(), workspace_.front.data(),
                         m_.weight.data()};
  candidate.evidence += mixture_log_likelihood(pass, refined.loss);
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

RelativePose EssentialProblem::annealed(const Candidate& start) {
  RefineOptions options;
  options.residual = residual_;
  options.loss.loss = Loss::kGemanMcClure;
  options.use_depths = true;
  options.max_iterations = 4;
  options.step_tolerance = 1e-7;
  RelativePose pose = start.pose;
  const double last = std::max(2.0 * start.loss.scale, 1e-4);
  for (double scale = std::max(kAnnealFrom, 2.0 * last); scale > last; scale *= 0.5) {
    options.loss.scale = scale;
    pose = epi360::refine(m_, pose, options, workspace_).pose;
  }
  return pose;
}

void EssentialProblem::polish_pool(int max_iterations) {
  if (pool_.empty()) return;
  const double total = std::accumulate(m_.weight.begin(), m_.weight.end(), 0.0);
  const double needed = kCompetitive * (total - pool_.front().score);
  for (Hypothesis& h : pool_) {
    if (h.polished || total - h.score < needed) continue;
    h.polished = true;
    const bool known = std::any_of(candidates_.begin(), candidates_.end(), [&](const Candidate& c) {
      return same_pose(c.pose, h.pose, kSameRotation, kSameDirection);
    });
    if (!known) polish(h.pose, max_iterations);
  }
  if (!candidates_.empty()) polish(annealed(candidates_.front()), max_iterations);
}

void EssentialProblem::refine(RelativePose& pose, double& best) {
  const Candidate candidate = polish(pose, kLocalIterations);
  const double value = score(candidate.pose, best);
  if (value >= best) return;
  pose = candidate.pose;
  best = value;
}

double EssentialProblem::inlier_ratio(const RelativePose& pose) {
  const LossModel mixture = mixture_at(pose);
  const double gate = gates_.size() == 1 ? gates_.front() : gate_of(mixture);
  double inliers = 0.0, total = 0.0;
  for (std::size_t i = 0; i < m_.size; ++i) {
    total += m_.weight[i] > 0.0;
    inliers +=
        m_.weight[i] > 0.0 && workspace_.front[i] > 0.5 && std::abs(workspace_.residuals[i]) < gate;
  }
  return total > 0.0 ? inliers / total : 0.0;
}

}  // namespace epi360
