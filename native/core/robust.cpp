// SPDX-License-Identifier: BSD-3-Clause
#include "robust.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "essential.h"
#include "essential_problem.h"
#include "evidence.h"
#include "plane.h"
#include "ransac.h"
#include "rotation_problem.h"

namespace epi360 {
namespace {

constexpr double kDegree = 0.017453292519943295;
constexpr double kInfinity = std::numeric_limits<double>::infinity();
// Gates of the first round when the noise is unknown: a sum of truncated costs over these scales
// follows the logarithm of the residual, so no scale is preferred.
const std::vector<double> kAllScales = {0.15 * kDegree, 0.45 * kDegree, 1.35 * kDegree,
                                        4.0 * kDegree};
constexpr int kScaleRounds = 3;          // re-sampling rounds while the gate still moves
constexpr double kGateSettled = 1.25;    // ratio of successive gates that counts as settled
constexpr double kRotationShare = 0.85;  // real pure rotations: >= 0.99, real motion: <= 0.69
constexpr double kLargestChance = 0.6;   // of a wrong match inside the gate: then it tells nothing
constexpr double kFalseAlarms = -3.0;    // log10; accepted below
constexpr double kPlaneShare = 0.9;      // of the inliers on one plane
constexpr double kPlaneSpread = 3.0;     // standard deviations of the log-likelihood ratio
constexpr double kSmallestParallax = 2.5;  // in noise; on real pairs directions are wrong below 3
constexpr double kRivalEvidence = -6.0;    // a second pose this likely (log) makes a pair ambiguous
constexpr std::size_t kSearchSize = 768;  // matches that the search looks at; all decide in the end
constexpr double kFinalistEvidence = -30.0;  // candidates of the search that all matches refine
constexpr double kTypicalDensity = 0.35;  // of wrong matches in front of both cameras, per radian
constexpr double kSmallestGate = 4e-6;    // radians, for exact data
constexpr double kLargestWrongParallax = 0.07;  // radians: depths must be right beyond it

// Among the four poses of this E, the one with most inliers in front of both cameras.
void decide_cheirality(const Matches& m, const std::vector<unsigned char>& inlier,
                       RelativePose& pose) {
  const Eigen::Matrix3d half_turn = 2.0 * pose.t * pose.t.transpose() - Eigen::Matrix3d::Identity();
  const RelativePose variants[4] = {
      pose, {pose.R, -pose.t}, {half_turn * pose.R, pose.t}, {half_turn * pose.R, -pose.t}};
  double best = -1.0;
  for (const RelativePose& variant : variants) {
    double count = 0.0;
    for (std::size_t i = 0; i < m.size; ++i) {
      if (!inlier[i]) continue;
      const Eigen::Vector3d b1(m.x1[i], m.y1[i], m.z1[i]), b2(m.x2[i], m.y2[i], m.z2[i]);
      count += in_front(variant, b1, b2, 0.0);
    }
    if (count > best) {
      best = count;
      pose = variant;
    }
  }
}

// Flags matches inside the gate and in front of both cameras; returns their number.
int mark_inliers(const Matches& m, const RobustOptions& options, const RelativePose& pose,
                 double gate, bool use_depths, std::vector<unsigned char>& inlier,
                 std::vector<double>& residuals) {
  std::vector<double> front(m.padded);
  residuals.resize(m.padded);
  compute_residuals(m, options.residual, plain(pose), std::min(gate, kLargestWrongParallax),
                    residuals.data(), front.data());
  inlier.assign(m.size, 0);
  int count = 0;
  for (std::size_t i = 0; i < m.size; ++i) {
    inlier[i] = std::abs(residuals[i]) < gate && (!use_depths || front[i] > 0.5);
    count += inlier[i];
  }
  return count;
}

// Sampling until the gate agrees with the noise found. Returns the number of samples.
int sample_poses(const RobustOptions& options, EssentialProblem& problem, Random& random) {
  LoopOptions loop{options.min_iterations, options.max_iterations, options.confidence};
  LoopResult<EssentialProblem> result;
  const std::uint32_t n = problem.num_matches();
  problem.set_gates(options.threshold > 0.0 ? std::vector<double>{options.threshold} : kAllScales);
  ransac(problem, n, loop, random, result);
  if (options.threshold > 0.0 || !result.found()) return result.num_iterations;
  loop.min_iterations = 0;
  double gate = kAllScales.back();
  for (int round = 0; round < kScaleRounds; ++round) {
    problem.polish_pool(12);
    const Candidate best = problem.candidates().front();
    const double next = std::max(gate_of(best.loss), kSmallestGate);
    const double change = std::max(next / gate, gate / next);
    gate = next;
    if (change < kGateSettled) break;
    problem.set_gates({gate});
    result.model = best.pose;
    result.score = problem.score(best.pose, kInfinity);
    ransac(problem, n, loop, random, result);
  }
  return result.num_iterations;
}

// The rotation that explains most matches, its residuals, and the number of matches within the
// gate.
int best_rotation(const Matches& m, double gate, Random& random, Eigen::Matrix3d* R,
                  std::vector<double>* residuals) {
  RotationProblem problem(m, {gate, 1.5 * gate, 2.2 * gate, 3.0 * gate});
  const LoopOptions loop{20, 500, 0.999};
  LoopResult<RotationProblem> result;
  ransac(problem, static_cast<std::uint32_t>(m.size), loop, random, result);
  // Samples of nearly equal bearings fix no rotation; all of them together may.
  *R = result.found() ? result.model : align_rotations(m, m.weight.data());
  problem.count_within(*R, gate);
  *residuals = problem.residuals();
  residuals->resize(m.size);
  return static_cast<int>(
      std::count_if(residuals->begin(), residuals->end(), [&](double r) { return r < gate; }));
}

void set_pure_rotation(const Matches& m, const Eigen::Matrix3d& R, double gate,
                       std::vector<double> residuals, RobustResult& out) {
  out.status = Status::kPureRotation;
  out.pose.R = R;
  out.residuals = std::move(residuals);
  out.inlier.assign(m.size, 0);
  double sum = 0.0, count = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!(out.residuals[i] < gate)) continue;
    out.inlier[i] = 1;
    sum += out.residuals[i] * out.residuals[i];
    count += 1.0;
  }
  // Two components a match, three parameters.
  out.scale = std::sqrt(sum / std::max(2.0 * count - 3.0, 1.0));
  // Each match measures the two components of the rotation across its direction, with variance
  // 2 scale^2: information (I - b b^T) / (2 scale^2).
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!out.inlier[i]) continue;
    const Eigen::Vector3d b(m.x2[i], m.y2[i], m.z2[i]);
    information += Eigen::Matrix3d::Identity() - b * b.transpose();
  }
  const double variance = 2.0 * std::max(out.scale * out.scale, 1e-24);
  out.covariance.setConstant(std::nan(""));
  out.covariance.topLeftCorner<3, 3>() = variance * information.inverse();
  out.coverage = sphere_coverage(m, out.inlier.data());
  RelativePose turn;
  turn.R = R;
  out.parallax = median_parallax(m, turn, out.inlier.data());
}

// Covariance from the inliers' normal equations; the inliers' scale is corrected for the part of a
// Gaussian that the gate cuts off.
void set_uncertainty(const Matches& m, const RobustOptions& options, double gate,
                     RobustResult& out) {
  Matches inliers_only = m;
  double sum = 0.0, count = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!out.inlier[i]) inliers_only.weight[i] = 0.0;
    sum += inliers_only.weight[i] * out.residuals[i] * out.residuals[i];
    count += inliers_only.weight[i];
  }
  double variance = sum / std::max(count - 5.0, 0.2 * count + 1e-9);
  // Variance of a unit Gaussian cut at +-k: 1 - 2 k phi(k) / (2 Phi(k) - 1); fixed point.
  const double observed = variance;
  for (int round = 0; round < 20; ++round) {
    const double k = gate / std::sqrt(std::max(variance, 1e-30));
    const double inside = std::erf(k / std::sqrt(2.0));
    const double kept = 1.0 - 2.0 * k * 0.3989422804014327 * std::exp(-0.5 * k * k) / inside;
    variance = observed / std::max(kept, 0.25);
  }
  out.scale = std::sqrt(variance);

  RefineWorkspace w;
  w.resize(m.padded);
  const Eigen::Matrix<double, 3, 2, Eigen::RowMajor> basis = tangent_basis(out.pose.t);
  compute_jacobians(m, options.residual, plain(out.pose), basis.data(), gate, w.residuals.data(),
                    w.front.data(), w.jacobian.data());
  // Near an epipole the first-order residual promises more than a bearing with noise can hold.
  for (std::size_t i = 0; i < m.size; ++i) {
    const Eigen::Vector3d a = out.pose.R * Eigen::Vector3d(m.x1[i], m.y1[i], m.z1[i]);
    const Eigen::Vector3d b(m.x2[i], m.y2[i], m.z2[i]);
    const double squared = a.cross(out.pose.t).squaredNorm() + b.cross(out.pose.t).squaredNorm();
    const double trust = squared / (squared + 8.0 * variance);
    inliers_only.weight[i] *= trust * trust;
  }
  double upper[15], gradient[5];
  accumulate_normal_equations(m.padded, w.jacobian.data(), w.residuals.data(),
                              inliers_only.weight.data(), upper, gradient);
  Eigen::Matrix<double, 5, 5> information;
  int entry = 0;
  for (int p = 0; p < 5; ++p) {
    for (int q = p; q < 5; ++q) information(p, q) = information(q, p) = upper[entry++];
  }
  out.covariance = variance * information.inverse();
}

// Whether two poses differ by more than the uncertainty of the first can explain.
bool distinct(const RelativePose& a, const RelativePose& b,
              const Eigen::Matrix<double, 5, 5>& covariance) {
  const double sigma_rotation = std::sqrt(covariance.topLeftCorner<3, 3>().trace());
  const double sigma_direction = std::sqrt(covariance.bottomRightCorner<2, 2>().trace());
  return !same_pose(a, b, std::max(3.0 * kDegree, 6.0 * sigma_rotation),
                    std::max(8.0 * kDegree, 6.0 * sigma_direction));
}

// The most likely pose that is truly different, and its support relative to the best pose. On a
// plane both poses are right but for noise, whose log-likelihoods differ by about the root of the
// number of matches; elsewhere a rival must be nearly as likely.
void find_rival(const Matches& m, const RobustOptions& options, EssentialProblem& problem,
                int support, double gate, RobustResult& out) {
  const double evidence = problem.candidates().front().evidence;
  double needed = kRivalEvidence, share = 0.0;
  const Eigen::Vector3d plane = fit_plane(m, out.pose, out.inlier, 1.5 * gate, &share);
  RelativePose twin;
  if (share > kPlaneShare && twin_pose(out.pose, plane, &twin)) {
    problem.polish(twin, 50, 1e-8);
    needed -= kPlaneSpread * std::sqrt(static_cast<double>(support));
  }
  const std::vector<Candidate> candidates = problem.candidates();
  for (const Candidate& c : candidates) {  // descending evidence
    if (!distinct(out.pose, c.pose, out.covariance)) continue;
    std::vector<unsigned char> inlier;
    std::vector<double> residuals;
    const int count = mark_inliers(m, options, c.pose, gate, true, inlier, residuals);
    out.rival_share = static_cast<double>(count) / std::max(support, 1);
    out.rival_evidence = c.evidence - evidence;
    if (out.rival_evidence > needed) out.alternatives.assign(1, c.pose);
    return;
  }
}

// Inliers, uncertainty and status of the best candidate.
void judge(const Matches& m, const RobustOptions& options, EssentialProblem& problem,
           Random& random, RobustResult& out) {
  const std::vector<Candidate>& candidates = problem.candidates();
  double gate = options.threshold;
  int support = 0;
  if (!candidates.empty()) {
    out.pose = candidates[0].pose;
    if (!(options.threshold > 0.0)) gate = std::max(gate_of(candidates[0].loss), kSmallestGate);
    mark_inliers(m, options, out.pose, gate, false, out.inlier, out.residuals);
    decide_cheirality(m, out.inlier, out.pose);
    support = mark_inliers(m, options, out.pose, gate, true, out.inlier, out.residuals);
  }
  if (!(gate > 0.0)) gate = kAllScales.front();
  out.threshold = gate;
  out.match_coverage = sphere_coverage(m, nullptr);

  out.coverage = sphere_coverage(m, out.inlier.data());
  const int n = static_cast<int>(m.size);
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  std::vector<double> rotation_residuals;
  const int turned = best_rotation(m, gate, random, &R, &rotation_residuals);
  out.rotation_share = static_cast<double>(turned) / std::max(support, 1);
  const ChanceDensity chance(m, options.residual, options.seed);
  if (turned >= kRotationShare * support &&
      log10_false_alarms(n, turned, chance.rotation_share(R, gate), 2) < kFalseAlarms) {
    set_pure_rotation(m, R, gate, std::move(rotation_residuals), out);
    return;
  }
  const double density =
      candidates.empty() ? kTypicalDensity : chance.at(out.pose, std::max(kDegree, gate));
  const double passing = 2.0 * gate * density;
  out.chance_log10 = log10_false_alarms(n, support, passing, options.sample_size);
  if (out.chance_log10 > kFalseAlarms || passing > kLargestChance) {
    out.status = Status::kTooFewInliers;
    return;
  }
  out.status = Status::kOk;
  set_uncertainty(m, options, gate, out);
  out.parallax = median_parallax(m, out.pose, out.inlier.data());
  if (out.parallax < kSmallestParallax * out.scale) {
    // Too little translation to tell where to: the rotation alone is the better answer.
    set_pure_rotation(m, R, gate, std::move(rotation_residuals), out);
    return;
  }
  find_rival(m, options, problem, support, gate, out);
  if (!out.alternatives.empty()) out.status = Status::kPlanarAmbiguous;
}

// A random part of the matches, large enough to find the pose in.
Matches random_subset(const Matches& m, Random& random) {
  std::vector<std::size_t> order(m.size);
  std::iota(order.begin(), order.end(), std::size_t{0});
  for (std::size_t k = 0; k < kSearchSize; ++k) {  // the beginning of a Fisher-Yates shuffle
    std::swap(order[k], order[k + random.below(static_cast<std::uint32_t>(m.size - k))]);
  }
  order.resize(kSearchSize);
  return chosen_matches(m, order);
}

}  // namespace

RobustResult estimate_relative_pose(const Matches& m, const RobustOptions& options) {
  RobustResult out;
  out.inlier.assign(m.size, 0);
  out.residuals.assign(m.padded, std::nan(""));
  out.covariance.setConstant(std::nan(""));
  out.scale = out.parallax = std::nan("");
  out.threshold = options.threshold > 0.0 ? options.threshold : std::nan("");
  if (m.size < static_cast<std::size_t>(options.sample_size)) return out;

  Random random(options.seed);
  const Matches subset = m.size > kSearchSize ? random_subset(m, random) : Matches{};
  EssentialProblem search(m.size > kSearchSize ? subset : m, options.residual, options.sample_size,
                          kTypicalDensity);
  out.num_iterations = sample_poses(options, search, random);
  search.polish_pool(25);
  EssentialProblem everything(m, options.residual, options.sample_size, kTypicalDensity);
  everything.set_gates({kAllScales.front()});
  for (const Candidate& candidate : search.candidates()) {
    if (candidate.evidence > search.candidates().front().evidence + kFinalistEvidence) {
      everything.polish(candidate.pose, 50, 1e-8);
    }
  }
  judge(m, options, everything, random, out);
  return out;
}

}  // namespace epi360
