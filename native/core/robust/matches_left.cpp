// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/matches_left.h"

#include <utility>

#include "core/refinement/refine.h"

namespace epi360 {

std::vector<unsigned char> mask_of(const Matches& m, const std::vector<std::size_t>& chosen) {
  std::vector<unsigned char> mask(m.size, 0);
  for (const std::size_t i : chosen) mask[i] = 1;
  return mask;
}

MatchesLeft only(const Matches& m, const MatchPriors& priors, std::vector<std::size_t> rows) {
  MatchesLeft left;
  left.priors = priors;
  left.priors.scores.clear();
  if (!priors.scores.empty()) {
    for (const std::size_t i : rows) left.priors.scores.push_back(priors.scores[i]);
  }
  left.m = chosen_matches(m, rows);
  left.rows = std::move(rows);
  return left;
}

MatchesLeft without(const Matches& m, const MatchPriors& priors,
                    const std::vector<std::size_t>& some) {
  const std::vector<unsigned char> is_left_out = mask_of(m, some);
  std::vector<std::size_t> rows;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!is_left_out[i]) rows.push_back(i);
  }
  return only(m, priors, std::move(rows));
}

std::vector<double> residuals_under(const RobustResult& answer, const Matches& m,
                                    Residual residual) {
  std::vector<double> residuals(m.padded), margins(m.padded);
  if (has_translation(answer.verdict.status)) {
    compute_residuals(m, residual, plain(answer.cam2_from_cam1), residuals.data(), margins.data());
  } else {
    const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rows = answer.cam2_from_cam1.R;
    compute_rotation_residuals(m, rows.data(), residuals.data());
  }
  return residuals;
}

RobustResult on_all(const Matches& m, const MatchesLeft& left, RobustResult answer,
                    Residual residual) {
  answer.residuals = residuals_under(answer, m, residual);
  std::vector<unsigned char> inlier(m.size, 0);
  for (std::size_t k = 0; k < left.rows.size(); ++k) inlier[left.rows[k]] = answer.inlier[k];
  answer.inlier = std::move(inlier);
  return answer;
}

}  // namespace epi360
