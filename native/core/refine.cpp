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

constexpr double kSettled = 3e-3;  // change of scale (relative) and shares that counts as none

RelativePose moved(const RelativePose& pose, const Eigen::Matrix<double, 3, 2>& basis,
                   const Vector5& step) {
  RelativePose next;
  next.R = exp_so3(step.head<3>()) * pose.R;
  next.t = (pose.t + basis * step.tail<2>()).normalized();
  return next;
}

MixturePass pass_over(const Matches& m, const Linearisation& at) {
  return {m.padded, at.residuals.data(), at.front.data(), m.weight.data(), m.unit_weights};
}

// Weights of all matches and what they cost together; the user's weights multiply both.
void weigh(const Matches& m, const LossModel& loss, Linearisation& at) {
  if (loss.loss == Loss::kMixture) {
    at.sums = mixture_pass(pass_over(m, at), loss, at.weights.data());
    at.objective = -at.sums.log_likelihood;
    return;
  }
  if (loss.loss == Loss::kGemanMcClure) {
    at.objective = geman_mcclure_pass(pass_over(m, at), loss.scale, at.weights.data());
    return;
  }
  at.objective = 0.0;
  for (std::size_t i = 0; i < m.padded; ++i) {
    const LossValue value = evaluate_loss(at.residuals[i] * at.residuals[i], loss);
    at.weights[i] = m.weight[i] * value.weight;
    at.objective += m.weight[i] * value.cost;
  }
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

// Maximisation step for scale and shares.
void update_mixture(const MixtureSums& sums, const RefineOptions& options, LossModel& loss) {
  const double total = sums.part[0] + sums.part[1] + sums.part[2] + sums.part[3];
  if (!(total > 0.0) || !(sums.count > 0.0)) return;
  // Five parameters were fitted to the inliers.
  const double freedom = std::max(total - 5.0, 0.2 * total);
  loss.scale = std::min(std::max(std::sqrt(sums.squares / freedom), options.smallest_scale),
                        options.largest_scale);
  set_shares(sums.part, sums.count, loss);
}

// Whether a mixture still moves.
bool changed(const LossModel& before, const LossModel& after) {
  bool any = std::abs(after.scale - before.scale) > kSettled * before.scale;
  for (int k = 0; k < LossModel::kGaussians; ++k) {
    any = any || std::abs(after.share[k] - before.share[k]) > kSettled;
  }
  return any;
}

void linearise(const Matches& m, const RefineOptions& options, const LossModel& loss,
               const RelativePose& pose, Linearisation& at) {
  const Eigen::Matrix<double, 3, 2, Eigen::RowMajor> basis = tangent_basis(pose.t);
  const double tolerance = options.use_depths ? depth_tolerance(loss.scale) : 1e300;
  compute_jacobians(m, options.residual, plain(pose), basis.data(), tolerance, at.residuals.data(),
                    at.front.data(), at.jacobian.data());
  weigh(m, loss, at);
}

}  // namespace

double depth_tolerance(double scale) { return std::min(3.0 * scale, 0.07); }

PlainPose plain(const RelativePose& pose) {
  PlainPose p;
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(p.R) = pose.R;
  Eigen::Map<Eigen::Vector3d>(p.t) = pose.t;
  return p;
}

void Linearisation::resize(std::size_t padded) {
  residuals.resize(padded);
  front.resize(padded);
  weights.resize(padded);
  jacobian.resize(5 * padded);
}

void RefineWorkspace::resize(std::size_t padded) {
  current.resize(padded);
  trial.resize(padded);
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
  bool adaptive = options.loss.loss == Loss::kMixture;
  linearise(m, options, result.loss, result.pose, w.current);
  if (adaptive) {  // the start's mixture may come from other residuals
    update_mixture(w.current.sums, options, result.loss);
    weigh(m, result.loss, w.current);
  }
  double damping = 1e-4;
  for (int iteration = 0; iteration < options.max_iterations; ++iteration) {
    double upper[15];
    Vector5 gradient;
    accumulate_normal_equations(m.padded, w.current.jacobian.data(), w.current.residuals.data(),
                                w.current.weights.data(), upper, gradient.data());
    const Matrix5 hessian = symmetric(upper);
    const Eigen::Matrix<double, 3, 2> basis = tangent_basis(result.pose.t);
    // Pose and mixture step from one set of posterior probabilities (expectation conditional
    // maximisation); together they may only become more likely.
    const bool updated = adaptive;
    if (adaptive) {
      const LossModel before = result.loss;
      update_mixture(w.current.sums, options, result.loss);
      // Expectation-maximisation creeps at the end; what it would still change hardly moves the
      // pose, which then converges fast.
      adaptive = changed(before, result.loss);
    }
    result.num_iterations = iteration + 1;

    const double sigma = options.sigma_tolerance * result.loss.scale;
    bool accepted = false, fresh = !updated;
    Vector5 step = Vector5::Zero();
    while (!accepted && damping < 1e8) {
      Matrix5 damped = hessian;
      damped.diagonal() *= 1.0 + damping;
      damped.diagonal().array() += 1e-15 * (1.0 + hessian.trace());
      step = -damped.ldlt().solve(gradient);
      if (!step.allFinite()) return result;
      if (step.norm() < options.step_tolerance) break;
      // -g.step = step^T H step: its squared length in units of the covariance scale^2 H^-1.
      if (-gradient.dot(step) < sigma * sigma) break;
      const RelativePose candidate = moved(result.pose, basis, step);
      linearise(m, options, result.loss, candidate, w.trial);
      if (w.trial.objective < w.current.objective) {
        result.pose = candidate;
        std::swap(w.current, w.trial);
        accepted = true;
        damping = std::max(damping * 0.1, 1e-9);
      } else if (!fresh) {  // limits on the shares can make the new mixture the less likely one
        weigh(m, result.loss, w.current);
        fresh = true;
        if (w.trial.objective >= w.current.objective) damping *= 10.0;
      } else {
        damping *= 10.0;
      }
    }
    // Without a step that lowers the cost it is a minimum to working precision.
    result.converged = !accepted || step.norm() < options.step_tolerance;
    if (result.converged) break;
  }
  if (options.loss.loss == Loss::kMixture) weigh(m, result.loss, w.current);
  result.cost = w.current.objective;
  if (options.loss.loss == Loss::kMixture)
    result.cost *= 2.0 * result.loss.scale * result.loss.scale;
  return result;
}

void set_statistics(const Matches& m, const RefineWorkspace& w, RefineResult& result) {
  double upper[15], gradient[5];
  const Linearisation& at = w.current;
  accumulate_normal_equations(m.padded, at.jacobian.data(), at.residuals.data(), at.weights.data(),
                              upper, gradient);
  result.information = symmetric(upper);
  for (std::size_t i = 0; i < m.size; ++i) {
    result.effective_matches += at.weights[i];
    result.weighted_squares += at.weights[i] * at.residuals[i] * at.residuals[i];
  }
}

namespace {

constexpr int kBins = 40;         // of |residual|, logarithmic
constexpr int kScales = 12;       // candidate standard deviations
constexpr int kStepsPerPart = 2;  // scale_of(k + 2) = 4 scale_of(k)
constexpr int kRows = kScales + kStepsPerPart * (LossModel::kGaussians - 1);
constexpr double kFirstBin = 1e-6;  // radians
constexpr double kBinsPerOctave = 1.8;

double bin_edge(int k) { return kFirstBin * std::exp2(k / kBinsPerOctave); }
double scale_of(int k) { return 4e-5 * std::exp2(k); }  // 0.002 to 6 degrees

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
    for (int round = 0; round < 4; ++round) {
      double in_part[LossModel::kGaussians] = {0.0};
      likelihood = 0.0;
      const bool last = round == 3;
      const double uniform = model.uniform_share() * 2.0 * outlier_density;
      for (int b = 0; b < kBins; ++b) {
        if (counts[b] == 0.0) continue;
        double part[LossModel::kGaussians], all = uniform * table.width[b];
        for (int j = 0; j < LossModel::kGaussians; ++j) {
          part[j] = model.share[j] * table.mass[k + kStepsPerPart * j][b];
          all += part[j];
        }
        for (int j = 0; j < LossModel::kGaussians; ++j) in_part[j] += counts[b] * part[j] / all;
        if (last) likelihood += counts[b] * std::log(all);
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
