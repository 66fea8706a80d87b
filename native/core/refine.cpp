// SPDX-License-Identifier: BSD-3-Clause
#include "refine.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>

#include "mixture.h"

namespace epi360 {
namespace {

using Vector5 = Eigen::Matrix<double, 5, 1>;
using Matrix5 = Eigen::Matrix<double, 5, 5>;

RelativePose moved(const RelativePose& pose, const Eigen::Matrix<double, 3, 2>& basis,
                   const Vector5& step) {
  RelativePose next;
  next.R = exp_so3(step.head<3>()) * pose.R;
  next.t = (pose.t + basis * step.tail<2>()).normalized();
  return next;
}

struct Totals {
  double cost = 0.0, weight = 0.0;
};

MixturePass pass_over(const Matches& m, const RefineWorkspace& w) {
  return {m.padded, w.residuals.data(), w.front.data(), m.weight.data()};
}

// Cost in units of squared residual: a constant times the negative log-likelihood.
double mixture_cost(const Matches& m, const LossModel& loss, const RefineWorkspace& w) {
  return -2.0 * loss.scale * loss.scale * mixture_log_likelihood(pass_over(m, w), loss);
}

double robust_cost(const Matches& m, const LossModel& loss, const RefineWorkspace& w) {
  if (loss.loss == Loss::kMixture) return mixture_cost(m, loss, w);
  const double behind = outlier_cost(loss);
  double cost = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    const bool wrong = behind >= 0.0 && w.front[i] < 0.5;
    cost +=
        m.weight[i] * (wrong ? behind : evaluate_loss(w.residuals[i] * w.residuals[i], loss).cost);
  }
  return cost;
}

// Cost and weights of all residuals; the user's weights multiply both.
Totals weigh(const Matches& m, const LossModel& loss, RefineWorkspace& w) {
  Totals totals;
  totals.cost = robust_cost(m, loss, w);
  if (loss.loss == Loss::kMixture) {
    totals.weight = mixture_weights(pass_over(m, w), loss, w.weights.data());
    return totals;
  }
  const bool bounded = outlier_cost(loss) >= 0.0;
  for (std::size_t i = 0; i < m.padded; ++i) {
    const bool wrong = bounded && w.front[i] < 0.5;
    const double s = w.residuals[i] * w.residuals[i];
    w.weights[i] = wrong ? 0.0 : m.weight[i] * evaluate_loss(s, loss).weight;
    totals.weight += w.weights[i];
  }
  return totals;
}

// Moves shares to the inliers until part k has at most `ratio` times theirs.
void limit_share(LossModel& loss, int k, double ratio) {
  const double both = loss.share[0] + loss.share[k];
  if (loss.share[k] <= ratio * loss.share[0]) return;
  loss.share[0] = both / (1.0 + ratio);
  loss.share[k] = both - loss.share[0];
}

// Shares of the parts. The inliers are the main body, not its sharp tip: their tail (4 scales) may
// hold half as many matches, the near misses behind it (16 scales) as many as they do.
void set_shares(const double* in_part, double count, LossModel& loss) {
  for (int k = 0; k < LossModel::kGaussians; ++k) loss.share[k] = in_part[k] / count;
  loss.share[0] = std::max(loss.share[0], 1e-3);
  limit_share(loss, 1, 0.5);
  limit_share(loss, 2, 1.0);
  const double sum = 1.0 - loss.uniform_share();
  if (sum > 0.999) {
    for (double& share : loss.share) share *= 0.999 / sum;
  }
}

// One step of expectation-maximisation for scale and shares at fixed residuals.
void update_mixture(const Matches& m, const RefineOptions& options, const RefineWorkspace& w,
                    LossModel& loss) {
  const MixtureSums sums = mixture_expectation(pass_over(m, w), loss);
  const double total = sums.part[0] + sums.part[1] + sums.part[2] + sums.part[3];
  if (!(total > 0.0) || !(sums.count > 0.0)) return;
  // Five parameters were fitted to the inliers.
  const double freedom = std::max(total - 5.0, 0.2 * total);
  loss.scale = std::min(std::max(std::sqrt(sums.squares / freedom), options.smallest_scale),
                        options.largest_scale);
  set_shares(sums.part, sums.count, loss);
}

double weighted_squares(const Matches& m, const RefineWorkspace& w) {
  double sum = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) sum += w.weights[i] * w.residuals[i] * w.residuals[i];
  return sum;
}

Matrix5 symmetric(const double* upper) {
  Matrix5 h;
  int entry = 0;
  for (int p = 0; p < 5; ++p) {
    for (int q = p; q < 5; ++q) h(p, q) = h(q, p) = upper[entry++];
  }
  return h;
}

}  // namespace

double depth_tolerance(double scale) { return std::min(3.0 * scale, 0.07); }

PlainPose plain(const RelativePose& pose) {
  PlainPose p;
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(p.R) = pose.R;
  Eigen::Map<Eigen::Vector3d>(p.t) = pose.t;
  return p;
}

void RefineWorkspace::resize(std::size_t padded) {
  residuals.resize(padded);
  front.resize(padded);
  weights.resize(padded);
  jacobian.resize(5 * padded);
}

double scale_evidence(const LossModel& mixture) { return 5.0 * std::log(mixture.scale); }

RefineResult refine(const Matches& m, const RelativePose& start, const RefineOptions& options,
                    RefineWorkspace& w) {
  w.resize(m.padded);
  RefineResult result;
  result.pose = start;
  // A long chain of products would drift away from orthonormality.
  result.pose.R = Eigen::Quaterniond(start.R).normalized().toRotationMatrix();
  result.loss = options.loss;
  double damping = 1e-4;
  for (int iteration = 0; iteration < options.max_iterations; ++iteration) {
    const Eigen::Matrix<double, 3, 2> basis = tangent_basis(result.pose.t);
    const Eigen::Matrix<double, 3, 2, Eigen::RowMajor> rows = basis;
    const double tolerance = options.use_depths ? depth_tolerance(result.loss.scale) : 1e300;
    compute_jacobians(m, options.residual, plain(result.pose), rows.data(), tolerance,
                      w.residuals.data(), w.front.data(), w.jacobian.data());
    if (result.loss.loss == Loss::kMixture && options.estimate_mixture) {
      update_mixture(m, options, w, result.loss);
    }
    const Totals totals = weigh(m, result.loss, w);
    double upper[15];
    Vector5 gradient;
    accumulate_normal_equations(m.padded, w.jacobian.data(), w.residuals.data(), w.weights.data(),
                                upper, gradient.data());
    result.information = symmetric(upper);
    result.cost = totals.cost;
    result.effective_matches = totals.weight;
    result.weighted_squares = weighted_squares(m, w);
    result.num_iterations = iteration + 1;

    bool accepted = false;
    Vector5 step = Vector5::Zero();
    while (!accepted && damping < 1e8) {
      Matrix5 damped = result.information;
      damped.diagonal() *= 1.0 + damping;
      damped.diagonal().array() += 1e-15 * (1.0 + result.information.trace());
      step = -damped.ldlt().solve(gradient);
      if (!step.allFinite()) return result;
      if (step.norm() < options.step_tolerance) break;
      const RelativePose candidate = moved(result.pose, basis, step);
      compute_residuals(m, options.residual, plain(candidate), tolerance, w.residuals.data(),
                        w.front.data());
      const double cost = robust_cost(m, result.loss, w);
      if (cost < totals.cost) {
        result.pose = candidate;
        result.cost = cost;
        accepted = true;
      }
      damping = accepted ? std::max(damping * 0.1, 1e-9) : damping * 10.0;
    }
    if (!accepted) {  // no step lowers the cost: a minimum to working precision
      result.converged = true;
      break;
    }
    if (step.norm() < options.step_tolerance) {
      result.converged = true;
      break;
    }
  }
  return result;
}

namespace {

constexpr int kBins = 56;         // of |residual|, logarithmic
constexpr int kScales = 18;       // candidate standard deviations
constexpr int kStepsPerPart = 3;  // scale_of(k + 3) = 4 scale_of(k)
constexpr int kRows = kScales + kStepsPerPart * (LossModel::kGaussians - 1);
constexpr double kFirstBin = 1e-6;  // radians
constexpr double kBinsPerOctave = 2.6;

double bin_edge(int k) { return kFirstBin * std::exp2(k / kBinsPerOctave); }
double scale_of(int k) { return 4e-5 * std::exp2(k * 2.0 / 3.0); }  // 0.002 to 6 degrees

// Probability that |residual| of a Gaussian falls into each bin, and each bin's width.
struct BinTable {
  std::array<std::array<double, kBins>, kRows> mass;
  std::array<double, kBins> width;
  BinTable() {
    for (int b = 0; b < kBins; ++b) {
      const double low = b == 0 ? 0.0 : bin_edge(b), high = bin_edge(b + 1);
      width[b] = high - low;
      for (int k = 0; k < kRows; ++k) {
        const double root = 1.0 / (scale_of(k) * std::sqrt(2.0));
        mass[k][b] = std::erf(high * root) - std::erf(low * root);
      }
    }
  }
};

}  // namespace

LossModel fit_mixture(const Matches& m, const double* residuals, const double* front,
                      double outlier_density, double smallest_scale) {
  static const BinTable table;
  std::array<double, kBins> counts{};
  double total = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    total += m.weight[i];
    if (front[i] < 0.5 || !std::isfinite(residuals[i])) continue;
    const double octave = std::log2(std::abs(residuals[i]) / kFirstBin + 1e-30);
    const int b = static_cast<int>(kBinsPerOctave * octave);
    if (b < kBins) counts[std::max(b, 0)] += m.weight[i];
  }
  LossModel best;
  double best_likelihood = -1e300;
  for (int k = 0; k < kScales; ++k) {
    if (scale_of(k) < smallest_scale) continue;
    LossModel model;
    model.loss = Loss::kMixture;
    model.outlier_density = outlier_density;
    model.scale = scale_of(k);
    double likelihood = 0.0;
    for (int round = 0; round < 5; ++round) {
      double in_part[LossModel::kGaussians] = {0.0};
      likelihood = 0.0;
      const double uniform = model.uniform_share() * 2.0 * outlier_density;
      for (int b = 0; b < kBins; ++b) {
        if (counts[b] == 0.0) continue;
        double part[LossModel::kGaussians], all = uniform * table.width[b];
        for (int j = 0; j < LossModel::kGaussians; ++j) {
          part[j] = model.share[j] * table.mass[k + kStepsPerPart * j][b];
          all += part[j];
        }
        for (int j = 0; j < LossModel::kGaussians; ++j) in_part[j] += counts[b] * part[j] / all;
        likelihood += counts[b] * std::log(all);
      }
      set_shares(in_part, total, model);
    }
    likelihood += scale_evidence(model);
    if (likelihood > best_likelihood) {
      best_likelihood = likelihood;
      best = model;
    }
  }
  return best;
}

}  // namespace epi360
