// SPDX-License-Identifier: BSD-3-Clause
// The normalisation N = diag(S, S, K) of least sum of absolute residuals (paper eq. 5 and 14). Step
// by step as the twin in epipolar/sk_search.py.
#pragma once

#include <Eigen/Core>
#include <cmath>

#include "core/matches.h"
#include "core/solvers/eight_point.h"

namespace epi360 {

enum class SkSearch { kLine, kLm };

// The function of eq. 14. With M = A^T A formed once, the normalised observation matrix has
// A(N)^T A(N) = D M D, D = N (x) N: an evaluation is one eigenvector and one pass over the matches.
class SkCost {
 public:
  explicit SkCost(const Matches& m);  // positive weights everywhere

  // E(S, K), ||E||_F = sqrt 2, rank 2 from the normalised domain.
  Eigen::Matrix3d essential(double S, double K) const;
  double operator()(double S, double K);
  double at(double u) { return (*this)(1.0, std::exp(u)); }
  int num_evaluations() const { return num_evaluations_; }

 private:
  const Matches& m_;
  Gram gram_;
  int num_evaluations_ = 0;
};

struct SkResult {
  double S = 1.0, K = 1.0, cost = 0.0;
  int num_evaluations = 0;
};

SkResult search_sk(SkCost& cost, SkSearch search);

}  // namespace epi360
