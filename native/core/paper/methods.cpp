// SPDX-License-Identifier: BSD-3-Clause
#include "core/paper/methods.h"

#include <array>
#include <utility>

#include "core/paper/residuals.h"
#include "core/refinement/refine.h"
#include "core/residuals/residuals.h"
#include "core/solvers/essential.h"
#include "core/solvers/svd3.h"

namespace epi360 {
namespace {

using RowMajor3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

PaperMethod linear(Normalization normalization) { return {normalization}; }

PaperMethod gold(bool search_sk, Weighting weighting, bool reweight) {
  return {Normalization::kNone, search_sk, true, weighting, reweight};
}

const std::array<std::pair<const char*, PaperMethod>, 14>& paper_methods() {
  using W = Weighting;
  static const std::array<std::pair<const char*, PaperMethod>, 14> methods = {{
      {"8pa", linear(Normalization::kNone)},
      {"8pa_isotropic", linear(Normalization::kIsotropic)},
      {"8pa_non_isotropic", linear(Normalization::kNonIsotropic)},
      {"8pa_isotropic_non_isotropic", linear(Normalization::kIsotropicNonIsotropic)},
      {"opt_sk", {Normalization::kNone, true}},
      {"gsm", gold(false, W::kNone, false)},
      {"gsm_w_xi", gold(false, W::kGaussian, false)},
      {"gsm_w_sk", gold(true, W::kGaussian, false)},
      {"gsm_irls_xi", gold(false, W::kGaussian, true)},
      {"gsm_irls_sk", gold(true, W::kGaussian, true)},
      {"gsm_w_xi_t", gold(false, W::kStudentT, false)},
      {"gsm_w_sk_t", gold(true, W::kStudentT, false)},
      {"gsm_irls_xi_t", gold(false, W::kStudentT, true)},
      {"gsm_irls_sk_t", gold(true, W::kStudentT, true)},
  }};
  return methods;
}

Eigen::Matrix3d linear_part(const Matches& m, const PaperMethod& method, SkSearch search,
                            PaperPose& result) {
  if (!method.search_sk) return solve_linear(m, method.normalization, Constraint::kUnit).E;
  SkCost cost(m);
  const SkResult best = search_sk(cost, search);
  result.S = best.S;
  result.K = best.K;
  result.cost = best.cost;
  result.num_evaluations = best.num_evaluations;
  return cost.essential(best.S, best.K);
}

// Constant weights: from the residuals of the SK matrix (w_SK) or of the 8-PA pose (w_xi).
std::vector<double> constant_weights(const Matches& m, const PaperMethod& method,
                                     const Eigen::Matrix3d& E, const RelativePose& pose) {
  if (method.weighting == Weighting::kNone || method.reweight) return m.weight;
  std::vector<double> residuals(m.padded), weights(m.padded);
  const RowMajor3 source = method.search_sk ? E : Eigen::Matrix3d(skew(pose.t) * pose.R);
  essential_residuals(m, source.data(), residuals.data());
  residual_weights(m, residuals.data(), method.weighting, weights.data());
  return weights;
}

}  // namespace

bool paper_method_named(const std::string& name, PaperMethod* method) {
  for (const auto& [known, value] : paper_methods()) {
    if (name != known) continue;
    *method = value;
    return true;
  }
  return false;
}

RelativePose pose_from_essential(const Matches& m, const Eigen::Matrix3d& E) {
  Eigen::Matrix3d essential = nearest_essential(E);
  if (!essential.allFinite()) essential = project_to_essential(E);
  const std::array<RelativePose, 4> poses = decompose_essential(essential);
  const RowMajor3 R = poses[0].R;
  const FrontCounts counts = count_in_front(m, R.data(), poses[0].t.data());
  int best = 0;
  for (int k = 1; k < 4; ++k) {
    if (counts.matches[k] > counts.matches[best]) best = k;
  }
  return poses[best];
}

PaperPose paper_pose(const Matches& m, const PaperMethod& method, SkSearch search,
                     Parameterization parameterization) {
  PaperPose result;
  result.converged = true;
  const Eigen::Matrix3d E = linear_part(m, method, search, result);
  result.cam2_from_cam1 = pose_from_essential(m, E);
  if (!method.gold_standard) return result;
  std::vector<double> weights = constant_weights(m, method, E, result.cam2_from_cam1);
  static_cast<GsmResult&>(result) =
      gold_standard(m, result.cam2_from_cam1, weights, parameterization,
                    method.reweight ? method.weighting : Weighting::kNone);
  return result;
}

}  // namespace epi360
