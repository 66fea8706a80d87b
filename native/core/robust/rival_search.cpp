// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/rival_search.h"

#include <algorithm>
#include <cstddef>
#include <utility>

#include "core/robust/candidates.h"
#include "core/robust/essential_problem.h"
#include "core/robust/pool.h"
#include "core/robust/ransac.h"
#include "core/robust/sampler.h"

namespace epi360 {
namespace {

// Share of the inliers that must be left for a rival, which shares the others with the pose; and
// the largest share of what is left that it is taken to explain.
constexpr double kFewestLeft = 0.6, kLargestShare = 0.9;
// Where so many times more regions than matches are left, a rival may explain this share of as
// many.
constexpr double kCrowded = 2.0, kShareBesideCrowd = 0.5;
constexpr double kConfidence = 0.95;      // that a sample of the rival alone is drawn
constexpr std::size_t kMostLooked = 512;  // matches that the search looks at
constexpr std::size_t kMostRivals = 2;
constexpr int kRivalPolishings = 12;

}  // namespace

RivalSearchResult search_rivals(const Matches& m, const RobustOptions& options,
                                const MatchPriors& priors, const std::vector<unsigned char>& inlier,
                                double gate, double regions_left, int max_iterations,
                                Random& random) {
  std::vector<std::size_t> left;
  double support = 0.0, weight_left = 0.0;
  std::size_t num_inliers = 0;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!(m.weight[i] > 0.0)) continue;
    if (inlier[i]) {
      ++num_inliers;
      support += m.weight[i];
    } else {
      left.push_back(i);
      weight_left += m.weight[i];
    }
  }
  const auto num_left = static_cast<double>(left.size());
  const bool enough = std::max(weight_left, regions_left * support) >= kFewestLeft * support;
  if (!enough) return {};
  const bool is_crowded = regions_left * support > kCrowded * weight_left;
  const double as_many = is_crowded ? kShareBesideCrowd : 1.0;
  const double share =
      std::min(as_many * static_cast<double>(num_inliers) / num_left, kLargestShare);
  return search_among(m, std::move(left), share, options, priors, gate, max_iterations, random);
}

RivalSearchResult search_among(const Matches& m, std::vector<std::size_t> some, double share,
                               const RobustOptions& options, const MatchPriors& priors, double gate,
                               int max_iterations, Random& random) {
  const int sample_size = priors.pose.has_gravity ? 3 : options.sample_size;
  if (max_iterations < 1 || some.size() < 2 * static_cast<std::size_t>(sample_size)) return {};
  if (some.size() > kMostLooked) {
    random.choose(some, 0, kMostLooked);
    some.resize(kMostLooked);
  }
  const Matches rest = chosen_matches(m, some);
  Candidates candidates(rest, options.residual, priors.pose);
  EssentialProblem problem(rest, options.residual, options.sample_size, candidates);
  if (priors.pose.has_gravity) problem.use_gravity(priors.pose.gravity1, priors.pose.gravity2);
  problem.set_gates({gate});

  RivalSearchResult result;
  result.num_iterations = iterations_needed(share, sample_size, {1, max_iterations, kConfidence});
  Sampler sampler(static_cast<std::uint32_t>(rest.size), sample_size);
  HypothesisPool pool;
  RelativePose models[EssentialProblem::kMaxModels];
  std::uint32_t sample[8];
  for (int drawn = 0; drawn < result.num_iterations; ++drawn) {
    sampler.draw(random, sample);
    const int num_models = problem.generate(sample, models);
    for (int k = 0; k < num_models; ++k) {
      pool.offer(models[k], problem.score(models[k], pool.worst()));
    }
  }
  candidates.polish_pool(pool, kRivalPolishings);
  candidates.anneal();
  for (const Candidate& c : candidates.all()) {
    if (result.poses.size() < kMostRivals) result.poses.push_back(c.cam2_from_cam1);
  }
  return result;
}

}  // namespace epi360
