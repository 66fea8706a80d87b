// SPDX-License-Identifier: BSD-3-Clause
// Pure rotation as a problem for the RANSAC loop: two matches make a model.
#pragma once

#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "matches.h"
#include "ransac.h"
#include "residuals.h"
#include "rotation.h"

namespace epi360 {

class RotationProblem {
 public:
  using Model = Eigen::Matrix3d;
  static constexpr int kMaxModels = 1;

  RotationProblem(const Matches& m, std::vector<double> gates)
      : m_(m), gates_(std::move(gates)), residuals_(m.padded), weights_(m.padded) {}

  int sample_size() const { return 2; }

  int generate(const std::uint32_t* sample, Model* models) {
    return rotation_of_two(view1(sample[0]), view2(sample[0]), view1(sample[1]), view2(sample[1]),
                           models);
  }

  double score(const Model& R, double limit) {
    const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rows = R;
    return truncated_rotation_score(m_, rows.data(), gates_.data(), static_cast<int>(gates_.size()),
                                    limit);
  }

  // Least squares over the matches inside ever smaller gates.
  void refine(Model& R, double& best) {
    Model current = R;
    for (int k = static_cast<int>(gates_.size()) - 1; k >= 0; --k) {
      for (int repeat = 0; repeat < 2; ++repeat) {
        if (count_within(current, gates_[k]) < 3.0) continue;
        for (std::size_t i = 0; i < m_.padded; ++i) {
          weights_[i] = residuals_[i] < gates_[k] ? m_.weight[i] : 0.0;
        }
        current = align_rotations(m_, weights_.data());
      }
      const double value = score(current, std::numeric_limits<double>::infinity());
      if (value < best) {
        best = value;
        R = current;
      }
    }
  }

  int needed(const Model& R, const LoopOptions& options, const Sampler&) {
    double total = 0.0;
    for (std::size_t i = 0; i < m_.size; ++i) total += m_.weight[i];
    const double ratio = total > 0.0 ? count_within(R, gates_.back()) / total : 0.0;
    return iterations_needed(ratio, sample_size(), options);
  }

  // Weight of the matches within a gate; residuals() then holds every residual.
  double count_within(const Model& R, double gate) {
    const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rows = R;
    compute_rotation_residuals(m_, rows.data(), residuals_.data());
    double count = 0.0;
    for (std::size_t i = 0; i < m_.size; ++i) count += residuals_[i] < gate ? m_.weight[i] : 0.0;
    return count;
  }

  const std::vector<double>& residuals() const { return residuals_; }

 private:
  Eigen::Vector3d view1(std::uint32_t i) const { return {m_.x1[i], m_.y1[i], m_.z1[i]}; }
  Eigen::Vector3d view2(std::uint32_t i) const { return {m_.x2[i], m_.y2[i], m_.z2[i]}; }

  const Matches& m_;
  std::vector<double> gates_;
  std::vector<double> residuals_, weights_;
};

}  // namespace epi360
