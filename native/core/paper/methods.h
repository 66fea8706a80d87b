// SPDX-License-Identifier: BSD-3-Clause
// Every estimator that the paper names, from matches without missing rows. The twin is
// estimation/paper_reference.py.
#pragma once

#include <string>

#include "core/matches.h"
#include "core/paper/gsm.h"
#include "core/paper/linear.h"
#include "core/paper/sk.h"
#include "core/pose.h"

namespace epi360 {

// What a name stands for: a linear solution, the search over (S, K) or not, and for the gold
// standard the distribution of its weights.
struct PaperMethod {
  Normalization normalization = Normalization::kNone;
  bool search_sk = false;
  bool gold_standard = false;
  Weighting weighting = Weighting::kNone;
  bool reweight = false;  // at every iteration instead of once
};

// False if there is no method of this name.
bool paper_method_named(const std::string& name, PaperMethod* method);

// The cost is that of the search (eq. 14) without a gold standard, zero without both.
struct PaperPose : GsmResult {
  double S = 1.0, K = 1.0;
  int num_evaluations = 0;  // of the search
};

// At least eight matches, all of weight one. Throws std::domain_error as solve_linear does.
PaperPose paper_pose(const Matches& m, const PaperMethod& method, SkSearch search,
                     Parameterization parameterization);

// The pose of E with most matches (weights summed) in front of both cameras: one pass over the
// matches for all four, and the first of equals.
RelativePose pose_from_essential(const Matches& m, const Eigen::Matrix3d& E);

}  // namespace epi360
