// SPDX-License-Identifier: BSD-3-Clause
// One RANSAC loop for every problem (Fischler & Bolles 1981; local optimisation after Chum, Matas &
// Kittler 2003). A problem brings
//   using Model;  static int kMaxModels;
//   int sample_size() const;
//   int generate(const uint32_t* sample, Model* models);   // models of a minimal sample
//   double score(const Model&, double limit);              // truncated cost; may stop above limit
//   void refine(Model&, double& score);                    // local optimisation, if it is better
//   double inlier_ratio(const Model&);                     // for the stopping rule
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>

#include "random.h"

namespace epi360 {

struct LoopOptions {
  int min_iterations = 30;
  int max_iterations = 10000;
  double confidence = 0.999;
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

// `result` may hold an incumbent; num_matches >= sample_size.
template <typename Problem>
void ransac(Problem& problem, std::uint32_t num_matches, const LoopOptions& options, Random& random,
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
    needed = iterations_needed(problem.inlier_ratio(result.model), problem.sample_size(), options);
  }
  for (int iteration = 0; iteration < needed; ++iteration) {
    random.distinct(num_matches, problem.sample_size(), sample);
    const int num_models = problem.generate(sample, models);
    ++result.num_iterations;
    int chosen = -1;
    for (int k = 0; k < num_models; ++k) {
      const double score = problem.score(models[k], best_sampled);
      if (score < best_sampled) {
        best_sampled = score;
        chosen = k;
      }
    }
    if (chosen < 0) continue;
    Model refined = models[chosen];
    double score = best_sampled;
    problem.refine(refined, score);
    if (score >= result.score) continue;
    result.model = refined;
    result.score = score;
    needed = iterations_needed(problem.inlier_ratio(result.model), problem.sample_size(), options);
  }
}

}  // namespace epi360
