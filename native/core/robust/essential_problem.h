// SPDX-License-Identifier: BSD-3-Clause
// The relative pose as a problem for the RANSAC loop.
#pragma once

#include <vector>

#include "core/matches.h"
#include "core/pose.h"
#include "core/residuals/residuals.h"
#include "core/robust/candidates.h"

namespace epi360 {

class EssentialProblem {
 public:
  using Model = RelativePose;
  static constexpr int kMaxModels = 20;  // ten essential matrices, rarely two poses each

  // `candidates` of the same matches refines poses and remembers what it found.
  EssentialProblem(const Matches& m, Residual residual, int sample_size, Candidates& candidates)
      : m_(m), residual_(residual), sample_size_(sample_size), candidates_(candidates) {}

  // Samples of three matches instead, with the directions of gravity in both cameras.
  void use_gravity(const Eigen::Vector3d& gravity1, const Eigen::Vector3d& gravity2);

  // The gates of the truncated score, radians: one or four.
  void set_gates(std::vector<double> gates);
  const std::vector<double>& gates() const { return gates_; }

  int sample_size() const { return sample_size_; }
  int generate(const std::uint32_t* sample, RelativePose* models) const;
  double score(const RelativePose& cam2_from_cam1, double limit) const;
  void refine(RelativePose& cam2_from_cam1);

 private:
  // Wrong parallax that a sample may show: the middle one of several gates.
  double depth_tolerance() const { return gates_[gates_.size() / 2]; }

  const Matches& m_;
  Residual residual_;
  int sample_size_;
  Candidates& candidates_;
  Eigen::Matrix3d upright1_, upright2_;
  std::vector<double> gates_;
};

}  // namespace epi360
