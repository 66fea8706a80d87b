// SPDX-License-Identifier: BSD-3-Clause
// One RANSAC loop for every problem (Fischler & Bolles 1981; local optimisation after Chum, Matas &
// Kittler 2003). A problem brings two sizes and three methods:
//   using Model;  static constexpr int kMaxModels;           // models of one sample at most
//   int sample_size() const;                                 // matches in a sample
//   int generate(const uint32_t* sample, Model* models) const;
//   double score(const Model&, double limit) const;          // truncated cost; may stop above
//   limit void refine(Model&);                                     // local optimisation
// Two more things accompany the loop. A pool remembers hypotheses for later:
//   double worst() const;                  // it keeps only what costs less than this
//   void offer(const Model&, double score);
// and inlier_share(model) tells when to stop.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "core/robust/random.h"
#include "core/robust/sampler.h"

namespace epi360 {

struct LoopOptions {
  int min_iterations = 20;
  int max_iterations = 10000;
  double confidence = 0.99;
};

// Iterations after which one all-inlier sample was drawn with the given confidence.
inline int iterations_needed(double inlier_ratio, int sample_size, const LoopOptions& options) {
  const double hit = std::pow(inlier_ratio, sample_size);
  if (!(hit > 1e-12)) return options.max_iterations;
  if (hit >= 1.0) return options.min_iterations;
  const double needed = std::ceil(std::log(1.0 - options.confidence) / std::log1p(-hit));
  if (needed >= options.max_iterations) return options.max_iterations;
  return needed < options.min_iterations ? options.min_iterations : static_cast<int>(needed);
}

template <typename Model>
struct LoopResult {
  Model model{};
  double score = std::numeric_limits<double>::infinity();
  int num_iterations = 0;
  bool found() const { return score < std::numeric_limits<double>::infinity(); }
};

// Keeps nothing.
struct NoPool {
  static double worst() { return -std::numeric_limits<double>::infinity(); }
  template <typename Model>
  void offer(const Model&, double) {}
};

// `result` may hold an incumbent; there are at least as many matches as the sample needs.
template <typename Problem, typename Pool, typename InlierShare>
void ransac(Problem& problem, Sampler& sampler, const LoopOptions& options, Random& random,
            Pool& pool, const InlierShare& inlier_share,
            LoopResult<typename Problem::Model>& result) {
  using Model = typename Problem::Model;
  const auto scored = [&](const Model& model, double limit) {
    const double score = problem.score(model, std::max(limit, pool.worst()));
    pool.offer(model, score);
    return score;
  };
  const auto iterations_for = [&](const Model& model) {
    return iterations_needed(inlier_share(model), problem.sample_size(), options);
  };
  Model models[Problem::kMaxModels];
  std::uint32_t sample[8];
  // A sample competes with the best sample, not with the refined best: raw hypotheses of the right
  // basin would rarely beat a refined one of a wrong basin.
  double best_sampled = std::numeric_limits<double>::infinity();
  int needed = result.found() ? iterations_for(result.model) : options.max_iterations;
  Model best_model = result.model;
  bool improved = false;
  while (result.num_iterations < needed) {
    sampler.draw(random, sample);
    const int num_models = problem.generate(sample, models);
    ++result.num_iterations;
    for (int k = 0; k < num_models; ++k) {
      const double score = scored(models[k], best_sampled);
      if (score >= best_sampled) continue;
      best_sampled = score;
      best_model = models[k];
      improved = true;
    }
    // The first samples only compete: most local optimisations would be of poor ones.
    if (!improved || result.num_iterations < options.min_iterations) continue;
    improved = false;
    Model refined = best_model;
    problem.refine(refined);
    double score = scored(refined, best_sampled);
    if (score >= best_sampled) {
      refined = best_model;
      score = best_sampled;
    }
    if (score >= result.score) continue;
    result.model = refined;
    result.score = score;
    needed = iterations_for(result.model);
  }
}

}  // namespace epi360
