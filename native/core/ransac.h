// SPDX-License-Identifier: BSD-3-Clause
// One RANSAC loop for every problem (Fischler & Bolles 1981; local optimisation after Chum, Matas &
// Kittler 2003). A problem brings
//   using Model;  static int kMaxModels;
//   int sample_size() const;
//   int generate(const uint32_t* sample, Model* models);   // models of a minimal sample
//   double score(const Model&, double limit);              // truncated cost; may stop above limit
//   void refine(Model&, double& score);                    // local optimisation, if it is better
//   int needed(const Model&, const LoopOptions&, const Sampler&);  // samples, to know when to stop
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>

#include "random.h"
#include "sampler.h"

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

template <typename Problem>
struct LoopResult {
  typename Problem::Model model{};
  double score = std::numeric_limits<double>::infinity();
  int num_iterations = 0;
  bool found() const { return score < std::numeric_limits<double>::infinity(); }
};

// `result` may hold an incumbent; there are at least as many matches as the sample needs.
template <typename Problem>
void ransac(Problem& problem, Sampler& sampler, const LoopOptions& options, Random& random,
            LoopResult<Problem>& result) {
  using Model = typename Problem::Model;
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  Model models[Problem::kMaxModels];
  std::uint32_t sample[8];
  // A sample competes with the best sample, not with the refined best: raw hypotheses of the right
  // basin would rarely beat a refined one of a wrong basin.
  double best_sampled = kInfinity;
  int needed = options.max_iterations;
  if (result.found()) {
    needed = problem.needed(result.model, options, sampler);
  }
  Model best_model = result.model;
  bool improved = false;
  while (result.num_iterations < needed) {
    sampler.draw(random, sample);
    const int num_models = problem.generate(sample, models);
    ++result.num_iterations;
    for (int k = 0; k < num_models; ++k) {
      const double score = problem.score(models[k], best_sampled);
      if (score >= best_sampled) continue;
      best_sampled = score;
      best_model = models[k];
      improved = true;
    }
    // The first samples only compete: most local optimisations would be of poor ones.
    if (!improved || result.num_iterations < options.min_iterations) continue;
    improved = false;
    Model refined = best_model;
    double score = best_sampled;
    problem.refine(refined, score);
    if (score >= result.score) continue;
    result.model = refined;
    result.score = score;
    needed = problem.needed(result.model, options, sampler);
  }
}

}  // namespace epi360
