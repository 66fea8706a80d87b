// SPDX-License-Identifier: BSD-3-Clause
// The paper's gold standard (section 4.3, eq. 13 and 15): Levenberg-Marquardt over the pose, with
// constant weights or with weights that follow the residuals. Step by step as its twin in
// estimation/paper_reference.py.
#pragma once

#include <vector>

#include "core/matches.h"
#include "core/paper/residuals.h"
#include "core/pose.h"

namespace epi360 {

enum class Parameterization { kManifold, kSe3 };

struct GsmResult {
  RelativePose cam2_from_cam1;
  double cost = 0.0;  // sum of weight * residual^2, the weights as the last step used them
  int num_iterations = 0;
  bool converged = false;
};

// weights: m.padded entries, zero on the padding; kNone keeps them, others set them at every
// iteration.
GsmResult gold_standard(const Matches& m, const RelativePose& start, std::vector<double>& weights,
                        Parameterization parameterization, Weighting reweight);

}  // namespace epi360
