// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/essential_problem.h"

#include <utility>

#include "core/refinement/refine.h"
#include "core/solvers/eight_point.h"
#include "core/solvers/essential.h"
#include "core/solvers/five_point.h"
#include "core/solvers/upright.h"

namespace epi360 {
namespace {

constexpr int kLocalIterations = 8;

// The sample's bearings, row-major as the solvers want them.
template <int N>
struct Sample {
  Eigen::Matrix<double, 3, N> b1, b2;
  Sample(const Matches& m, const std::uint32_t* indices) {
    for (int k = 0; k < N; ++k) {
      const std::uint32_t i = indices[k];
      b1.col(k) << m.x1[i], m.y1[i], m.z1[i];
      b2.col(k) << m.x2[i], m.y2[i], m.z2[i];
    }
  }
};

// Appends R with t or -t where the whole sample lies in front of both cameras: most wrong
// hypotheses end here, before any scoring. Turning t round changes the sign of both depths.
template <int N>
int append_signs(const Eigen::Matrix3d& R, const Eigen::Vector3d& t, const Sample<N>& sample,
                 double tolerance, RelativePose* models) {
  bool ahead = true, behind = true;
  for (int k = 0; k < N && (ahead || behind); ++k) {
    const DepthMargins d = depth_margins({R, t}, sample.b1.col(k), sample.b2.col(k));
    ahead = ahead && d.first > -tolerance && d.second > -tolerance;
    behind = behind && d.first < tolerance && d.second < tolerance;
  }
  int count = 0;
  if (ahead) models[count++] = {R, t};
  if (behind) models[count++] = {R, -t};
  return count;
}

template <int N>
int append_poses(const Eigen::Matrix3d& E, const Sample<N>& sample, double tolerance,
                 RelativePose* models) {
  const EssentialFactors f = factors_of(E);
  const int count = append_signs<N>(f.R[0], f.t, sample, tolerance, models);
  return count + append_signs<N>(f.R[1], f.t, sample, tolerance, models + count);
}

}  // namespace

void EssentialProblem::use_gravity(const Eigen::Vector3d& gravity1,
                                   const Eigen::Vector3d& gravity2) {
  sample_size_ = 3;
  upright1_ = upright_from(gravity1);
  upright2_ = upright_from(gravity2);
}

void EssentialProblem::set_gates(std::vector<double> gates) {
  gates_ = std::move(gates);
  candidates_.set_depth_tolerance(depth_tolerance());
}

int EssentialProblem::generate(const std::uint32_t* indices, RelativePose* models) const {
  if (sample_size_ == 8) {
    const Sample<8> sample(m_, indices);
    Eigen::Matrix3d E;
    if (!eight_point_minimal(sample.b1, sample.b2, &E)) return 0;
    return append_poses<8>(project_to_essential(E), sample, depth_tolerance(), models);
  }
  if (sample_size_ == 3) {
    const Sample<3> sample(m_, indices);
    RelativePose poses[4];
    const int num = upright_three_point(sample.b1, sample.b2, upright1_, upright2_, poses);
    int count = 0;
    for (int k = 0; k < num; ++k) {
      count += append_signs<3>(poses[k].R, poses[k].t, sample, depth_tolerance(), models + count);
    }
    return count;
  }
  const Sample<5> sample(m_, indices);
  Eigen::Matrix<double, 3, 3, Eigen::RowMajor> essentials[10];
  const int num = five_point(sample.b1.data(), sample.b2.data(), essentials[0].data());
  int count = 0;
  for (int k = 0; k < num && count + 4 <= kMaxModels; ++k) {
    count += append_poses<5>(essentials[k], sample, depth_tolerance(), models + count);
  }
  return count;
}

double EssentialProblem::score(const RelativePose& pose, double limit) const {
  return truncated_score(m_, residual_, plain(pose), gates_.data(), static_cast<int>(gates_.size()),
                         limit);
}

void EssentialProblem::refine(RelativePose& pose) {
  pose = candidates_.polish(pose, kLocalIterations).cam2_from_cam1;
}

}  // namespace epi360
