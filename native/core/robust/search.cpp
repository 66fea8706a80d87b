// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/search.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "core/robust/derivative_noise.h"
#include "core/robust/essential_problem.h"
#include "core/robust/pool.h"
#include "core/robust/ransac.h"

namespace epi360 {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// Gates of the first round when the noise is unknown: a sum of truncated costs over these scales
// follows the logarithm of the residual, so no scale is preferred.
const std::vector<double> kAllScales = {0.15 * kDegree, 0.45 * kDegree, 1.35 * kDegree,
                                        4.0 * kDegree};
constexpr int kScaleRounds = 3;           // re-sampling rounds while the gate still moves
constexpr double kGateSettled = 1.25;     // ratio of successive gates that counts as settled
constexpr double kSmallestGate = 4e-6;    // radians, for exact data
constexpr std::size_t kSearchSize = 512;  // matches that the search looks at; all decide in the end
constexpr std::size_t kJurySize = 20000;  // that choose among its candidates, where there are more
constexpr std::size_t kMostFinalists = 2;   // which they leave to all
constexpr double kFinalistEvidence = 30.0;  // how much less likely a finalist may be than the best
constexpr double kFewestOrdered =
    30.0;  // best scored matches whose share of inliers means something

std::vector<std::size_t> counted_up(std::size_t n) {
  std::vector<std::size_t> numbers(n);
  std::iota(numbers.begin(), numbers.end(), std::size_t{0});
  return numbers;
}

// Indices by descending score; equal scores in random order.
std::vector<std::size_t> by_score(const std::vector<double>& scores, Random& random) {
  std::vector<std::size_t> order = counted_up(scores.size());
  for (std::size_t k = order.size(); k > 1; --k) {
    std::swap(order[k - 1], order[random.below(static_cast<std::uint32_t>(k))]);
  }
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return scores[a] > scores[b]; });
  return order;
}

// The matches that the search looks at, of all in the order of their scores: half of them the best,
// the others from everywhere, because scores may mislead.
std::vector<std::size_t> picked(std::vector<std::size_t> order, std::size_t num, bool scored,
                                Random& random) {
  const std::size_t best = scored ? num / 2 : 0;
  random.choose(order, best, num);
  order.resize(num);
  return order;
}

// The matches that the search looks at, in its order; empty for all of them in theirs.
std::vector<std::size_t> searched(const Matches& m, const std::vector<double>& scores,
                                  Random& random) {
  const bool scored = !scores.empty(), partly = m.size > kSearchSize;
  if (!scored && !partly) return {};
  std::vector<std::size_t> chosen = counted_up(m.size);
  if (scored) chosen = by_score(scores, random);
  if (partly) chosen = picked(std::move(chosen), kSearchSize, scored, random);
  if (scored && partly) {
    std::stable_sort(chosen.begin(), chosen.end(),
                     [&](std::size_t a, std::size_t b) { return scores[a] > scores[b]; });
  }
  return chosen;
}

// A pose with more noise than key points have may agree with most matches, and hide the right one,
// which agrees with fewer. Above this scale of residuals, sampling goes on as if no larger share
// agreed.
struct Hiding {
  double scale, share;
};

Hiding hiding(double max_noise, Residual residual) {
  constexpr double kUsualNoise = 0.6 * kDegree;  // where nobody has said how much there is
  if (!(max_noise > 0.0)) return {kUsualNoise, 0.6};
  return {max_noise / noise_per_residual(residual), 0.35};
}

// Share of inliers among the matches that samples come from.
double inlier_share(const Matches& m, const RelativePose& pose, const EssentialProblem& problem,
                    const Sampler& sampler, const Hiding& noisy, Candidates& candidates) {
  const LossModel mixture = candidates.mixture_at(pose);
  const Linearisation& at = candidates.linearisation();
  const double gate = problem.gates().size() == 1 ? problem.gates().front() : gate_of(mixture);
  double inliers = 0.0, total = 0.0, best = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (m.weight[i] > 0.0) {
      total += 1.0;
      inliers += at.margins[i] > -candidates.depth_tolerance() && std::abs(at.residuals[i]) < gate;
    }
    // Progressive samples came from the first matches only: they may stop as soon as those say so.
    const bool considered = sampler.progressive() && i + 1 >= sampler.reached();
    if (considered && total >= kFewestOrdered) best = std::max(best, inliers / total);
  }
  if (total > 0.0) best = std::max(best, inliers / total);
  return mixture.scale > noisy.scale ? std::min(best, noisy.share) : best;
}

// Samples after which a pose with the fewest inliers that are believed would have been hit. Who
// believes no pose with fewer than these still learns how many there are.
constexpr int kFewestSought = 15;

LoopOptions limits_of_loop(const Matches& m, int sample_size, const RobustOptions& options) {
  LoopOptions loop{options.min_iterations, options.max_iterations, options.confidence};
  const auto weighs = [](double weight) { return weight > 0.0; };
  const auto num_usable = std::count_if(m.weight.begin(), m.weight.end(), weighs);
  const int fewest = std::min(options.min_num_inliers, kFewestSought);
  const double share = fewest / std::max<double>(num_usable, 1.0);
  loop.max_iterations = iterations_needed(std::min(share, 1.0), sample_size, loop);
  return loop;
}

// Sampling until the gate agrees with the noise found. Returns the number of samples.
int sample_poses(const Matches& m, const RobustOptions& options, double max_noise,
                 EssentialProblem& problem, Sampler& sampler, Random& random,
                 Candidates& candidates) {
  const LoopOptions loop = limits_of_loop(m, problem.sample_size(), options);
  HypothesisPool pool;
  LoopResult<RelativePose> result;
  const Hiding noisy = hiding(max_noise, options.residual);
  const auto share = [&](const RelativePose& pose) {
    return inlier_share(m, pose, problem, sampler, noisy, candidates);
  };
  const bool is_known = options.threshold > 0.0;
  problem.set_gates(is_known ? std::vector<double>{options.threshold} : kAllScales);
  ransac(problem, sampler, loop, random, pool, share, result);
  double gate = kAllScales.back();
  for (int round = 0; round < kScaleRounds && !is_known && result.found(); ++round) {
    candidates.polish_pool(pool, 12);
    candidates.give_up_blurred();
    if (candidates.empty()) break;
    const Candidate best = candidates.best();
    const double next = estimated_gate(best.loss);
    const double change = std::max(next / gate, gate / next);
    gate = next;
    if (change < kGateSettled) break;
    problem.set_gates({gate});
    pool.rescore([&](const RelativePose& pose) { return problem.score(pose, kInfinity); });
    result.model = best.cam2_from_cam1;
    result.score = problem.score(result.model, kInfinity);
    pool.offer(result.model, result.score);
    ransac(problem, sampler, loop, random, pool, share, result);
  }
  candidates.polish_pool(pool, 25);
  return result.num_iterations;
}

// The candidates that all matches refine. A million of them would refine two dozen for minutes.
std::vector<Candidate> finalists(const Matches& m, const RobustOptions& options,
                                 const MatchPriors& priors, const std::vector<Candidate>& all,
                                 Random& random) {
  if (m.size <= kJurySize) return all;
  const Matches jury = chosen_matches(m, picked(counted_up(m.size), kJurySize, false, random));
  Candidates judged(jury, options.residual, priors.pose);
  judged.set_depth_tolerance(default_gate());
  judged.finish(all, kFinalistEvidence);
  std::vector<Candidate> best = judged.all();
  if (best.size() > kMostFinalists) best.resize(kMostFinalists);
  return best;
}

}  // namespace

double default_gate() { return kAllScales.front(); }

double estimated_gate(const LossModel& mixture) {
  return std::max(gate_of(mixture), kSmallestGate);
}

SearchResult search_poses(const Matches& m, const RobustOptions& options, const MatchPriors& priors,
                          Random& random) {
  const std::vector<std::size_t> order = searched(m, priors.scores, random);
  const bool is_reordered = !order.empty();
  const Matches chosen = is_reordered ? chosen_matches(m, order) : Matches{};
  const Matches& used = is_reordered ? chosen : m;
  Candidates candidates(used, options.residual, priors.pose);
  EssentialProblem problem(used, options.residual, options.sample_size, candidates);
  if (priors.pose.has_gravity) problem.use_gravity(priors.pose.gravity1, priors.pose.gravity2);
  Sampler sampler(static_cast<std::uint32_t>(used.size), problem.sample_size(),
                  !priors.scores.empty());
  const int num_iterations =
      sample_poses(used, options, priors.max_noise, problem, sampler, random, candidates);
  candidates.give_up_blurred();
  candidates.anneal();
  candidates.give_up_blurred();
  if (!is_reordered) {
    candidates.finish(candidates.all(), kFinalistEvidence);
    candidates.give_up_blurred();
    return {std::move(candidates), num_iterations};
  }
  Candidates of_all(m, options.residual, priors.pose);
  of_all.set_depth_tolerance(default_gate());
  of_all.finish(finalists(m, options, priors, candidates.all(), random), kFinalistEvidence);
  of_all.give_up_blurred();
  return {std::move(of_all), num_iterations};
}

}  // namespace epi360
