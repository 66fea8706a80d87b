// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/testimony.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "core/bearings.h"
#include "core/constants.h"
#include "core/refinement/refine.h"
#include "core/robust/covariance.h"
#include "core/robust/fixed_content.h"
#include "core/robust/neighbourhoods.h"
#include "core/robust/random.h"
#include "core/solvers/dense.h"

namespace epi360 {
namespace {

constexpr std::size_t kMostWitnesses = 512;  // more are thinned out at random
constexpr double kUnderfoot = 0.866;         // cosine of 30 degrees
// Side of a neighbourhood in gates: nearer partners agree with whatever their matches agree with.
constexpr double kNeighbourhood = 4.0;
constexpr double kFreeInformation = 1.0;  // per radian^2: what is known without matches

// For each match the share of exchanged partners of its neighbourhoods, in either view, with which
// it would be an inlier too; `agree` marks the inliers of other matches.
template <typename Agree>
std::vector<double> agreement_by_exchange(const Matches& m, double gate, const Agree& agree) {
  std::vector<double> agreeing(m.size, 0.0), tried(m.size, 0.0);
  std::vector<unsigned char> agrees;
  for (int view = 1; view <= 2; ++view) {
    const Exchange e = exchanged_partners(m, view, kNeighbourhood * gate);
    const Matches exchanged =
        view == 1 ? paired_matches(m, e.own, e.other) : paired_matches(m, e.other, e.own);
    agrees.resize(exchanged.padded);
    agree(exchanged, agrees);
    for (std::size_t k = 0; k < e.own.size(); ++k) {
      agreeing[e.own[k]] += agrees[k];
      tried[e.own[k]] += 1.0;
    }
  }
  for (std::size_t i = 0; i < m.size; ++i) agreeing[i] /= std::max(tried[i], 1.0);
  return agreeing;
}

// What stands still in the image (a tripod, a car, a logo) agrees with every pose that hardly
// turns, and says nothing of the scene: such matches lose their weight, unless they are most
// inliers and so the scene itself, far away.
void leave_out_what_is_fixed(const Matches& m, const Linearisation& at, double gate,
                             std::vector<double>& weights) {
  const double tolerance = std::min(gate, kLargestWrongParallax);
  const auto agrees = [&](std::size_t i) {
    return at.margins[i] > -tolerance && std::abs(at.residuals[i]) < gate;
  };
  std::size_t num_inliers = 0;
  for (std::size_t i = 0; i < m.size; ++i) num_inliers += agrees(i);
  std::vector<std::size_t> fixed = standing_still(m, gate);
  fixed.erase(std::remove_if(fixed.begin(), fixed.end(), [&](auto i) { return !agrees(i); }),
              fixed.end());
  if (2 * fixed.size() >= num_inliers) return;
  for (const std::size_t i : fixed) weights[i] = 0.0;
}

// The likeliest share of right matches, by expectation maximisation.
double share_of_right(const std::vector<double>& weights, const std::vector<double>& odds,
                      double total) {
  if (!(total > 0.0)) return 0.0;
  double share = 0.3;
  for (int round = 0; round < 30; ++round) {
    double sum = 0.0;
    for (std::size_t i = 0; i < odds.size(); ++i) {
      sum += weights[i] * share * odds[i] / (share * odds[i] + 1.0 - share);
    }
    const double next = std::min(std::max(sum / total, 1e-6), 0.98);
    const bool settled = std::abs(next - share) < 1e-3 * share;
    share = next;
    if (settled) break;
  }
  return share;
}

}  // namespace

std::vector<double> votes_of(const Matches& m, const PosePrior& prior) {
  std::vector<double> votes = region_weights(m);
  if (!prior.has_gravity) return votes;
  std::vector<std::size_t> underfoot;
  for (std::size_t i = 0; i < m.size; ++i) {
    const double down1 = prior.gravity1.dot(view1(m, i)), down2 = prior.gravity2.dot(view2(m, i));
    if (std::min(down1, down2) > kUnderfoot) underfoot.push_back(i);
  }
  if (2 * underfoot.size() >= m.size) return votes;
  for (const std::size_t i : underfoot) votes[i] = 0.0;
  return votes;
}

Matches witnesses(const Matches& m, std::uint64_t seed) {
  if (m.size <= kMostWitnesses) return m;
  Random random(seed ^ 0x3c6ef372fe94f82bULL);
  std::vector<std::size_t> chosen(m.size);
  std::iota(chosen.begin(), chosen.end(), std::size_t{0});
  random.choose(chosen, 0, kMostWitnesses);
  chosen.resize(kMostWitnesses);
  return chosen_matches(m, chosen);
}

Testimony testimony(const Matches& all, Residual residual, const RelativePose& pose, double scale,
                    double gate, double density, const PosePrior& prior, std::uint64_t seed) {
  const Matches m = witnesses(all, seed);
  const double sigma = std::max(scale, m.least_scale);
  const double tolerance = std::min(gate, kLargestWrongParallax);
  std::vector<double> residuals, margins;
  const std::vector<double> exchanged =
      agreement_by_exchange(m, gate, [&](const Matches& other, std::vector<unsigned char>& agrees) {
        residuals.resize(other.padded);
        margins.resize(other.padded);
        compute_residuals(other, residual, plain(pose), residuals.data(), margins.data());
        for (std::size_t k = 0; k < other.size; ++k) {
          agrees[k] = (margins[k] > -tolerance) & (std::abs(residuals[k]) < gate);
        }
      });
  std::vector<double> weights = votes_of(m, prior);

  Linearisation at;
  at.resize(m.padded);
  const Eigen::Matrix<double, 3, 2, Eigen::RowMajor> basis = tangent_basis(pose.t);
  compute_jacobians(m, residual, plain(pose), basis.data(), at.residuals.data(), at.margins.data(),
                    at.jacobian.data());
  leave_out_what_is_fixed(m, at, gate, weights);
  // How much more likely each residual is if the match is right, than if it is wrong.
  std::vector<double> odds(m.size);
  double total = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    const double z = at.residuals[i] / sigma;
    const double right =
        (at.margins[i] > -tolerance) * kInverseRootTwoPi / sigma * std::exp(-0.5 * z * z);
    odds[i] = right / std::max(density, exchanged[i] / (2.0 * gate));
    total += weights[i];
  }
  const double share = share_of_right(weights, odds, total);
  Testimony result;
  result.all_regions = total;
  std::fill(at.weights.begin(), at.weights.end(), 0.0);
  for (std::size_t i = 0; i < m.size; ++i) {
    const double both = share * odds[i] + 1.0 - share;
    const double agreeing = weights[i] * share * odds[i] / both;
    result.log_ratio += weights[i] * std::log(both);
    result.num_regions += agreeing;
    const double trust = epipole_trust(pose, view1(m, i), view2(m, i), sigma * sigma);
    at.weights[i] = trust * trust * agreeing;
  }
  double upper[15], gradient[5];
  accumulate_normal_equations(m.padded, at.jacobian.data(), at.residuals.data(), at.weights.data(),
                              upper, gradient);
  const Matrix5 information =
      kFreeInformation * Matrix5::Identity() + symmetric(upper) / (sigma * sigma);
  const Matrix5 covariance = inverse(information);
  result.direction_sigma = direction_sigma(covariance);
  return result;
}

double rotation_log_ratio(const Matches& all, const Eigen::Matrix3d& R, double scale, double gate,
                          double wrong, std::uint64_t seed) {
  const Matches m = witnesses(all, seed);
  const double sigma = std::max(scale, m.least_scale);
  const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rows = R;
  std::vector<double> residuals;
  const std::vector<double> exchanged =
      agreement_by_exchange(m, gate, [&](const Matches& other, std::vector<unsigned char>& agrees) {
        residuals.resize(other.padded);
        compute_rotation_residuals(other, rows.data(), residuals.data());
        for (std::size_t k = 0; k < other.size; ++k) agrees[k] = residuals[k] < gate;
      });
  const std::vector<double> weights = region_weights(m);
  residuals.resize(m.padded);
  compute_rotation_residuals(m, rows.data(), residuals.data());
  // Right ones scatter as two Gaussian components do; wrong ones fill the disc of the gate evenly.
  std::vector<double> odds(m.size);
  double total = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    const double z = residuals[i] / sigma, reach = gate / sigma;
    const double within = std::max(wrong, exchanged[i]);
    odds[i] = 0.5 * reach * reach / within * std::exp(-0.5 * z * z);
    total += weights[i];
  }
  const double share = share_of_right(weights, odds, total);
  double log_ratio = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    log_ratio += weights[i] * std::log(share * odds[i] + 1.0 - share);
  }
  return log_ratio;
}

}  // namespace epi360
