// SPDX-License-Identifier: BSD-3-Clause
// Pure rotation as a problem for the RANSAC loop: two matches make a model.
#pragma once

#include <cstdint>
#include <vector>

#include "core/matches.h"
#include "core/pose.h"
#include "core/robust/random.h"

namespace epi360 {

constexpr int kRotationSample = 2;  // matches that make a rotation

class RotationProblem {
 public:
  using Model = Eigen::Matrix3d;
  static constexpr int kMaxModels = 1;

  RotationProblem(const Matches& m, std::vector<double> gates);

  int sample_size() const { return kRotationSample; }
  int generate(const std::uint32_t* sample, Model* models) const;
  double score(const Model& R, double limit) const;
  // Least squares over the matches inside ever smaller gates.
  void refine(Model& R);

  // Share of the matches within the widest gate, by weight.
  double inlier_share(const Model& R);
  // Weight of the matches within a gate; residuals() then holds every residual.
  double count_within(const Model& R, double gate);
  const std::vector<double>& residuals() const { return residuals_; }

 private:
  const Matches& m_;
  std::vector<double> gates_;
  std::vector<double> residuals_, weights_;
};

// A rotation, the residuals of all matches under it, the weight of those within the gate, and the
// share of wrong matches that lie there.
struct RotationFit {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  std::vector<double> residuals;
  int support = 0;
  double wrong = 1.0;
};

// The rotation that explains most matches.
RotationFit best_rotation(const Matches& m, double gate, Random& random);

// Whether a rotation may explain the inliers: of twenty made from two inliers each, one would come
// near most of them. Spares real motion the search of best_rotation.
bool rotation_possible(const Matches& m, const std::vector<unsigned char>& inlier, int support,
                       double gate, Random& random);

}  // namespace epi360
