// SPDX-License-Identifier: BSD-3-Clause
#include "robust.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>

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
constexpr double kRotationMostly = 0.5;  // of the inliers, where there is hardly any parallax
constexpr double kRotationNear = 0.4;    // of the inliers, near a rotation: worth a search
constexpr double kReleased = 2.0 * kDegree, kReleasedSupport = 0.8, kReleasedParallax = 0.8;
constexpr double kReleasedEvidence = 60.0;
constexpr double kWrongGravity = 15.0 * kDegree;
constexpr double kLargestLeverage = 0.25;    // the mean is 5 over the number of inliers
constexpr double kUnusualParallax = 4.0;     // times the median
constexpr double kEnoughForLeverage = 80.0;  // inliers
constexpr int kLeverageRounds = 4;
constexpr double kLargestChance = 0.6;  // of a wrong match inside the gate: then it tells nothing
constexpr double kFalseAlarms = -3.0;   // log10; accepted below
constexpr double kPlaneShare = 0.9;     // of the inliers on one plane
constexpr double kPlaneSpread = 3.0;    // standard deviations of the log-likelihood ratio
// Of the median parallax, in noise. A pure rotation shows 1.7 (the median of two components of
// noise, 1.18 sigma, where the residual sees one of both views). Directions of real pairs are wrong
// below 3; noise above half a degree is that of no key point, and independent.
constexpr double kSmallestParallax = 2.5, kSmallestNoisyParallax = 2.0;
constexpr double kNoisy = 0.5 * kDegree;
constexpr double kRivalEvidence = -6.0;   // a second pose this likely (log) makes a pair ambiguous
constexpr std::size_t kSearchSize = 768;  // matches that the search looks at; all decide in the end
constexpr double kFinalistEvidence = 30.0;  // candidates of the search that all matches refine
constexpr double kTypicalDensity = 0.35;    // of wrong matches in front of both cameras, per radian
constexpr double kSmallestGate = 4e-6;      // radians, for exact data
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

// In a narrow view with much noise, a turn along the epipolar planes hardly changes the residuals,
// and large false parallax puts every wrong match in front of both cameras: the count of depths
// then pulls poses away from the residuals' own optimum, and prefers wrong ones. Where such an
// optimum has much less parallax and nearly the support of the best candidate, it takes its place.
void release_depths(const Matches& m, const RobustOptions& options, EssentialProblem& problem) {
  if (problem.candidates().empty()) return;
  const std::vector<Candidate> candidates = problem.candidates();
  const Candidate& best = candidates.front();
  const double gate = gate_of(best.loss);
  std::vector<unsigned char> inlier;
  std::vector<double> residuals;
  const int support = mark_inliers(m, options, best.pose, gate, true, inlier, residuals);
  const double parallax = median_parallax(m, best.pose, inlier.data());
  double most = -kInfinity;
  for (const Candidate& c : candidates) {
    if (c.evidence < best.evidence - kReleasedEvidence) break;
    Candidate released = problem.without_depths(c);
    if (released.evidence < most ||
        same_pose(best.pose, released.pose, kReleased, 2.0 * kReleased)) {
      most = std::max(most, released.evidence);
      continue;
    }
    mark_inliers(m, options, released.pose, gate, false, inlier, residuals);
    decide_cheirality(m, inlier, released.pose);
    const int kept = mark_inliers(m, options, released.pose, gate, true, inlier, residuals);
    if (kept < kReleasedSupport * support) continue;
    if (!(median_parallax(m, released.pose, inlier.data()) < kReleasedParallax * parallax))
      continue;
    most = released.evidence;
    released.evidence = best.evidence;
    problem.replace_best(released);
  }
}

// Sampling until the gate agrees with the noise found. Returns the number of samples.
int sample_poses(const RobustOptions& options, EssentialProblem& problem, Sampler& sampler,
                 Random& random) {
  LoopOptions loop{options.min_iterations, options.max_iterations, options.confidence};
  LoopResult<EssentialProblem> result;
  problem.set_gates(options.threshold > 0.0 ? std::vector<double>{options.threshold} : kAllScales);
  ransac(problem, sampler, loop, random, result);
  if (options.threshold > 0.0 || !result.found()) return result.num_iterations;
  double gate = kAllScales.back();
  for (int round = 0; round < kScaleRounds; ++round) {
    problem.polish_pool(12);
    if (problem.candidates().empty()) break;
    const Candidate best = problem.candidates().front();
    const double next = std::max(gate_of(best.loss), kSmallestGate);
    const double change = std::max(next / gate, gate / next);
    gate = next;
    if (change < kGateSettled) break;
    problem.set_gates({gate});
    result.model = best.pose;
    result.score = problem.score(best.pose, kInfinity);
    ransac(problem, sampler, loop, random, result);
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
  Sampler sampler(static_cast<std::uint32_t>(m.size), problem.sample_size());
  ransac(problem, sampler, loop, random, result);
  // Samples of nearly equal bearings fix no rotation; all of them together may.
  *R = result.found() ? result.model : align_rotations(m, m.weight.data());
  problem.count_within(*R, gate);
  *residuals = problem.residuals();
  residuals->resize(m.size);
  return static_cast<int>(
      std::count_if(residuals->begin(), residuals->end(), [&](double r) { return r < gate; }));
}

// Whether a rotation may explain the inliers: of twenty made from two inliers each, one would come
// near most of them. Spares real motion the search of best_rotation.
bool rotation_possible(const Matches& m, const std::vector<unsigned char>& inlier, int support,
                       double gate, Random& random) {
  std::vector<std::uint32_t> chosen;
  double total = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    total += m.weight[i];
    if (inlier[i]) chosen.push_back(static_cast<std::uint32_t>(i));
  }
  if (support < 10) return true;
  const double wide = 3.0 * gate, limit = total - kRotationNear * support;
  int tried = 0;
  for (int round = 0; round < 20; ++round) {
    std::uint32_t pick[2];
    random.distinct(static_cast<std::uint32_t>(chosen.size()), 2, pick);
    const std::uint32_t i = chosen[pick[0]], j = chosen[pick[1]];
    Eigen::Matrix3d R;
    if (!rotation_of_two({m.x1[i], m.y1[i], m.z1[i]}, {m.x2[i], m.y2[i], m.z2[i]},
                         {m.x1[j], m.y1[j], m.z1[j]}, {m.x2[j], m.y2[j], m.z2[j]}, &R)) {
      continue;
    }
    ++tried;
    const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rows = R;
    if (truncated_rotation_score(m, rows.data(), &wide, 1, limit) < limit) return true;
  }
  return tried < 10;  // nearly equal bearings fix no rotation
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

// Standard deviation of the inliers' residuals, corrected for the part of a Gaussian that the gate
// cuts off.
double inlier_scale(const Matches& m, const RobustResult& out, double gate) {
  double sum = 0.0, count = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!out.inlier[i]) continue;
    sum += m.weight[i] * out.residuals[i] * out.residuals[i];
    count += m.weight[i];
  }
  // Variance of a unit Gaussian cut at +-k: 1 - 2 k phi(k) / (2 Phi(k) - 1); fixed point.
  const double observed = sum / std::max(count - 5.0, 0.2 * count + 1e-9);
  double variance = observed;
  for (int round = 0; round < 20; ++round) {
    const double k = gate / std::sqrt(std::max(variance, 1e-30));
    const double inside = std::erf(k / std::sqrt(2.0));
    const double kept = 1.0 - 2.0 * k * 0.3989422804014327 * std::exp(-0.5 * k * k) / inside;
    variance = observed / std::max(kept, 0.25);
  }
  return std::sqrt(variance);
}

// Derivative of one residual by the five parameters of the pose.
Eigen::Matrix<double, 5, 1> jacobian_of(const Linearisation& at, std::size_t padded,
                                        std::size_t i) {
  Eigen::Matrix<double, 5, 1> J;
  for (std::size_t k = 0; k < 5; ++k) J[static_cast<Eigen::Index>(k)] = at.jacobian[k * padded + i];
  return J;
}

// Covariance of an M-estimator (Huber 1981): (mean psi^2 / (mean psi')^2) (J^T J)^-1, with the
// derivative psi of the negative log-likelihood, so that the wrong matches which agree by chance
// count as the noise they are. Errors of neighbouring matches go together in real images
// (calibration, stitching, rolling shutter): the sum of psi J varies over the cells of the sphere
// more than independent errors would let it, and the covariance grows by that ratio.
void set_uncertainty(const Matches& m, const RobustOptions& options, const LossModel& loss,
                     const std::vector<unsigned char>& dropped, double gate, RobustResult& out) {
  using Vector5 = Eigen::Matrix<double, 5, 1>;
  using Matrix5 = Eigen::Matrix<double, 5, 5>;
  out.scale = inlier_scale(m, out, gate);
  const double variance = out.scale * out.scale;

  Linearisation at;
  at.resize(m.padded);
  const Eigen::Matrix<double, 3, 2, Eigen::RowMajor> basis = tangent_basis(out.pose.t);
  compute_jacobians(m, options.residual, plain(out.pose), basis.data(), gate, at.residuals.data(),
                    at.front.data(), at.jacobian.data());
  std::fill(at.weights.begin(), at.weights.end(), 0.0);
  double slope = 0.0, square = 0.0, count = 0.0;
  Matrix5 independent = Matrix5::Zero();
  std::array<Vector5, kNumCells> sums;
  sums.fill(Vector5::Zero());
  for (std::size_t i = 0; i < m.size; ++i) {
    if (at.front[i] < 0.5 || dropped[i]) continue;
    const double r = at.residuals[i];
    const LossSlopes psi = mixture_slopes(r, loss);
    slope += m.weight[i] * psi.second;
    square += m.weight[i] * m.weight[i] * psi.first * psi.first;
    // Near an epipole the first-order residual promises more than a bearing with noise can hold.
    const Eigen::Vector3d a = out.pose.R * Eigen::Vector3d(m.x1[i], m.y1[i], m.z1[i]);
    const Eigen::Vector3d b(m.x2[i], m.y2[i], m.z2[i]);
    const double squared = a.cross(out.pose.t).squaredNorm() + b.cross(out.pose.t).squaredNorm();
    const double trust = squared / (squared + 8.0 * variance);
    if (out.inlier[i]) {
      at.weights[i] = m.weight[i] * trust * trust;
      count += m.weight[i];
    }
    const Vector5 score = m.weight[i] * trust * psi.first * jacobian_of(at, m.padded, i);
    independent += score * score.transpose();
    sums[cell_of(b)] += score;
  }
  Matrix5 clustered = Matrix5::Zero();
  for (const Vector5& sum : sums) clustered += sum * sum.transpose();
  const double together = independent.ldlt().solve(clustered).trace() / 5.0;

  double upper[15], gradient[5];
  accumulate_normal_equations(m.padded, at.jacobian.data(), at.residuals.data(), at.weights.data(),
                              upper, gradient);
  const double freedom = count / std::max(count - 5.0, 0.2 * count + 1e-9);
  const double efficiency = slope > 0.0 ? square * count / (slope * slope) : variance;
  out.covariance = std::max(efficiency * freedom, variance) * std::max(together, 1.0) *
                   symmetric(upper).inverse();
}

// Whether two poses differ by more than the uncertainty of the first can explain.
bool distinct(const RelativePose& a, const RelativePose& b,
              const Eigen::Matrix<double, 5, 5>& covariance) {
  const double sigma_rotation = std::sqrt(covariance.topLeftCorner<3, 3>().trace());
  const double sigma_direction = std::sqrt(covariance.bottomRightCorner<2, 2>().trace());
  return !same_pose(a, b, std::max(3.0 * kDegree, 6.0 * sigma_rotation),
                    std::max(8.0 * kDegree, 6.0 * sigma_direction));
}

// The most likely pose that is truly different, where it is likely enough to matter. On a
// plane both poses are right but for noise, whose log-likelihoods differ by about the root of the
// number of matches; elsewhere a rival must be nearly as likely.
void find_rival(const Matches& m, EssentialProblem& problem, int support, double gate,
                RobustResult& out) {
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
    if (c.evidence - evidence > needed) out.alternatives.assign(1, c.pose);
    return;
  }
}

// Inliers, uncertainty and status of the best candidate.
void judge(const Matches& m, const RobustOptions& options, EssentialProblem& problem,
           const std::vector<unsigned char>& dropped, Random& random, RobustResult& out) {
  const std::vector<Candidate>& candidates = problem.candidates();
  double gate = options.threshold;
  int support = 0;
  if (!candidates.empty()) {
    out.pose = candidates[0].pose;
    if (!(options.threshold > 0.0)) gate = std::max(gate_of(candidates[0].loss), kSmallestGate);
    mark_inliers(m, options, out.pose, gate, false, out.inlier, out.residuals);
    decide_cheirality(m, out.inlier, out.pose);
    support = mark_inliers(m, options, out.pose, gate, true, out.inlier, out.residuals);
    for (std::size_t i = 0; i < m.size; ++i) {
      support -= out.inlier[i] && dropped[i];
      out.inlier[i] = out.inlier[i] && !dropped[i];
    }
  }
  if (!(gate > 0.0)) gate = kAllScales.front();
  out.threshold = gate;
  out.match_coverage = sphere_coverage(m, nullptr);

  out.coverage = sphere_coverage(m, out.inlier.data());
  const int n = static_cast<int>(m.size);
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  std::vector<double> rotation_residuals;
  const int turned = candidates.empty() || rotation_possible(m, out.inlier, support, gate, random)
                         ? best_rotation(m, gate, random, &R, &rotation_residuals)
                         : 0;
  const ChanceDensity chance(m, options.residual, options.seed);
  if (turned >= kRotationShare * support &&
      log10_false_alarms(n, turned, chance.rotation_share(R, gate), 2) < kFalseAlarms) {
    set_pure_rotation(m, R, gate, std::move(rotation_residuals), out);
    return;
  }
  const double density =
      candidates.empty() ? kTypicalDensity : chance.at(out.pose, std::max(kDegree, gate));
  const double passing = 2.0 * gate * density;
  if (log10_false_alarms(n, support, passing, options.sample_size) > kFalseAlarms ||
      passing > kLargestChance) {
    out.status = Status::kTooFewInliers;
    return;
  }
  out.status = Status::kOk;
  set_uncertainty(m, options, candidates[0].loss, dropped, gate, out);
  out.parallax = median_parallax(m, out.pose, out.inlier.data());
  const double least = out.scale > kNoisy ? kSmallestNoisyParallax : kSmallestParallax;
  if (out.parallax < least * out.scale) {
    // Too little translation to tell where to: the rotation alone is the better answer.
    const int explained = turned ? turned : best_rotation(m, gate, random, &R, &rotation_residuals);
    if (explained >= kRotationMostly * support) {
      set_pure_rotation(m, R, gate, std::move(rotation_residuals), out);
      return;
    }
  }
  find_rival(m, problem, support, gate, out);
  if (!out.alternatives.empty()) out.status = Status::kPlanarAmbiguous;
}

// The matches that the search looks at, of all in the order of their scores: half of them the best,
// the others from everywhere, because scores may mislead.
std::vector<std::size_t> searched(std::vector<std::size_t> order, bool scored, Random& random) {
  const std::size_t best = scored ? kSearchSize / 2 : 0;
  for (std::size_t k = best; k < kSearchSize; ++k) {  // the beginning of a Fisher-Yates shuffle
    const auto left = static_cast<std::uint32_t>(order.size() - k);
    std::swap(order[k], order[k + random.below(left)]);
  }
  order.resize(kSearchSize);
  return order;
}

// Indices by descending score; equal scores in random order.
std::vector<std::size_t> order_of(const std::vector<double>& scores, Random& random) {
  std::vector<std::size_t> order(scores.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  for (std::size_t k = order.size(); k > 1; --k) {
    std::swap(order[k - 1], order[random.below(static_cast<std::uint32_t>(k))]);
  }
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return scores[a] > scores[b]; });
  return order;
}

// A wrong match that agrees by chance may hold a thousand times the information of the right ones:
// one with 100 degrees of parallax among far points. No such match may fix the pose alone: those
// whose leverage and parallax are beyond the limits are left out, and the pose is refined again.
// Flags them. (With few inliers, right ones have such leverage too.)
std::vector<unsigned char> drop_leverage(const Matches& m, const RobustOptions& options,
                                         EssentialProblem& problem) {
  std::vector<unsigned char> dropped(m.size, 0);
  if (problem.candidates().empty()) return dropped;
  Matches trusted;
  RefineWorkspace workspace;
  RefineOptions refinement;
  refinement.residual = options.residual;
  refinement.step_tolerance = 1e-12;
  refinement.sigma_tolerance = 1e-4;
  for (int round = 0; round < kLeverageRounds; ++round) {
    Candidate best = problem.candidates().front();
    refinement.loss = best.loss;
    refinement.use_depths = best.uses_depths;
    const Matches& used = round == 0 ? m : trusted;
    // In the first round only to linearise: the pose is an optimum already.
    refinement.max_iterations = round == 0 ? 1 : 30;
    RefineResult refined = refine(used, best.pose, refinement, workspace);
    if (round > 0) {
      best.pose = refined.pose;
      best.loss = refined.loss;
      problem.replace_best(best);
    }
    set_statistics(used, workspace, refined);
    if (!(refined.effective_matches >= kEnoughForLeverage)) break;
    std::vector<unsigned char> believed(m.size);
    for (std::size_t i = 0; i < m.size; ++i) believed[i] = workspace.current.weights[i] > 0.0;
    const double usual = median_parallax(m, best.pose, believed.data());
    const Eigen::Matrix<double, 5, 5> inverse = refined.information.inverse();
    bool any = false;
    for (std::size_t i = 0; i < m.size; ++i) {
      const double weight = workspace.current.weights[i];
      if (!(weight > 0.0)) continue;
      const Eigen::Matrix<double, 5, 1> J = jacobian_of(workspace.current, m.padded, i);
      if (weight * J.dot(inverse * J) <= kLargestLeverage) continue;
      const Eigen::Vector3d a = best.pose.R * Eigen::Vector3d(m.x1[i], m.y1[i], m.z1[i]);
      const Eigen::Vector3d b(m.x2[i], m.y2[i], m.z2[i]);
      if (!(direction_angle(a, b) > kUnusualParallax * usual)) continue;
      if (!any && round == 0) trusted = m;
      any = true;
      dropped[i] = 1;
    }
    if (!any) break;
    for (std::size_t i = 0; i < m.size; ++i) {
      if (dropped[i]) trusted.weight[i] = 0.0;
    }
  }
  return dropped;
}

// Whether a pose was found and turns gravity as it should; otherwise it is searched without.
bool agrees_with_gravity(const RobustResult& out, const MatchPriors& priors) {
  if (out.status != Status::kOk && out.status != Status::kPureRotation) return false;
  return direction_angle(out.pose.R * priors.gravity1, priors.gravity2) < kWrongGravity;
}

}  // namespace

RobustResult estimate_relative_pose(const Matches& m, const RobustOptions& options,
                                    const MatchPriors& priors) {
  RobustResult out;
  out.inlier.assign(m.size, 0);
  out.residuals.assign(m.padded, std::nan(""));
  out.covariance.setConstant(std::nan(""));
  out.scale = out.parallax = std::nan("");
  out.threshold = options.threshold > 0.0 ? options.threshold : std::nan("");
  if (m.size < static_cast<std::size_t>(std::max(options.sample_size, 5))) return out;

  Random random(options.seed);
  const bool scored = !priors.scores.empty(), partly = m.size > kSearchSize;
  const bool apart = scored || partly;  // the search has matches of its own
  std::vector<std::size_t> chosen(m.size);
  std::iota(chosen.begin(), chosen.end(), std::size_t{0});
  if (scored) chosen = order_of(priors.scores, random);
  if (partly) chosen = searched(std::move(chosen), scored, random);
  if (scored && partly) {
    std::stable_sort(chosen.begin(), chosen.end(), [&](std::size_t a, std::size_t b) {
      return priors.scores[a] > priors.scores[b];
    });
  }
  const Matches subset = apart ? chosen_matches(m, chosen) : Matches{};
  EssentialProblem search(apart ? subset : m, options.residual, options.sample_size,
                          kTypicalDensity);
  if (priors.has_gravity) search.use_gravity(priors.gravity1, priors.gravity2);
  Sampler sampler(search.num_matches(), search.sample_size(), scored);
  out.num_iterations = sample_poses(options, search, sampler, random);
  search.polish_pool(25);
  search.anneal();
  std::optional<EssentialProblem> everything;
  if (apart) {
    everything.emplace(m, options.residual, options.sample_size, kTypicalDensity);
    everything->set_gates({kAllScales.front()});
  }
  EssentialProblem& last = apart ? *everything : search;
  last.finish(search.candidates(), kFinalistEvidence);
  if (apart) last.anneal();
  release_depths(m, options, last);
  last.simplify();
  const std::vector<unsigned char> dropped = drop_leverage(m, options, last);
  judge(m, options, last, dropped, random, out);
  if (priors.has_gravity && !agrees_with_gravity(out, priors)) {
    MatchPriors free = priors;
    free.has_gravity = false;
    RobustResult again = estimate_relative_pose(m, options, free);
    again.num_iterations += out.num_iterations;
    return again;
  }
  return out;
}

}  // namespace epi360
