// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/leverage.h"

#include "core/bearings.h"
#include "core/robust/covariance.h"
#include "core/robust/evidence.h"
#include "core/solvers/dense.h"

namespace epi360 {
namespace {

constexpr double kLargestLeverage = 0.25;    // the mean is 5 over the number of inliers
constexpr double kUnusualParallax = 4.0;     // times the median
constexpr double kEnoughForLeverage = 80.0;  // inliers
constexpr int kLeverageRounds = 4;

}  // namespace

std::vector<unsigned char> drop_leverage(const Matches& m, Residual residual,
                                         Candidates& candidates) {
  std::vector<unsigned char> dropped(m.size, 0);
  if (candidates.empty()) return dropped;
  Matches trusted;
  RefineWorkspace& workspace = candidates.workspace();
  RefineOptions refinement;
  refinement.residual = residual;
  refinement.prior = candidates.prior();
  refinement.smallest_scale = m.least_scale;
  refinement.step_tolerance = 1e-12;
  refinement.sigma_tolerance = 1e-4;
  refinement.behind = Behind::kOutlier;
  for (int round = 0; round < kLeverageRounds; ++round) {
    Candidate best = candidates.best();
    refinement.loss = best.loss;
    const Matches& used = round == 0 ? m : trusted;
    // In the first round only to linearise: the pose is an optimum already.
    refinement.max_iterations = round == 0 ? 0 : 30;
    RefineResult refined = refine(used, best.cam2_from_cam1, refinement, workspace);
    if (round > 0) {
      best.cam2_from_cam1 = refined.cam2_from_cam1;
      best.loss = refined.loss;
      candidates.replace_best(best);
    }
    set_statistics(used, workspace, refined);
    if (!(refined.effective_matches >= kEnoughForLeverage)) break;
    std::vector<unsigned char> believed(m.size);
    for (std::size_t i = 0; i < m.size; ++i) believed[i] = workspace.current.weights[i] > 0.0;
    double usual = -1.0;  // the median parallax, which few need
    const Matrix5 covariance = inverse(refined.information);
    bool any = false;
    for (std::size_t i = 0; i < m.size; ++i) {
      const double weight = workspace.current.weights[i];
      if (!(weight > 0.0)) continue;
      const Eigen::Matrix<double, 5, 1> J = jacobian_of(workspace.current, m.padded, i);
      if (!(weight * J.dot(covariance * J) > kLargestLeverage)) continue;
      if (usual < 0.0) usual = median_parallax(m, best.cam2_from_cam1, believed.data());
      const Eigen::Vector3d a = best.cam2_from_cam1.R * view1(m, i);
      const Eigen::Vector3d b = view2(m, i);
      if (!(direction_angle(a, b) > kUnusualParallax * usual)) continue;
      if (!any && round == 0) trusted = m;
      any = true;
      dropped[i] = 1;
    }
    if (!any) break;
    for (std::size_t i = 0; i < m.size; ++i) {
      if (dropped[i]) trusted.weight[i] = 0.0;
    }
  }
  return dropped;
}

}  // namespace epi360
