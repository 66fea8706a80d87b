// SPDX-License-Identifier: BSD-3-Clause
// The paper's gold standard (section 4.3, eq. 13 and 15): Levenberg-Marquardt over the pose, with
// constant weights or with weights that follow the residuals. Step by step as its twin in
// estimation/paper_reference.py.
#pragma once

#include <vector>

#include "core/matches.h"
#include "core/paper/weights.h"
#include "core/pose.h"

namespace epi360 {

enum class Parameterization { kManifold, kSe3 };

struct GsmOptions {
  Parameterization parameterization = Parameterization::kManifold;
  Weighting reweight = Weighting::kNone;  // at every iteration; kNone keeps the given weights
  int max_iterations = 100;
  double step_tolerance = 1e-10;
};

struct GsmResult {
  RelativePose cam2_from_cam1;
  double cost =
      0.0;  // sum of weight times squared residual, the weights as the last step used them
  int num_iterations = 0;
  bool converged = false;
};

// weights: m.padded entries, zero on the padding; changed if options.reweight says so.
GsmResult gold_standard(const Matches& m, const RelativePose& start, std::vector<double>& weights,
                        const GsmOptions& options);

}  // namespace epi360
