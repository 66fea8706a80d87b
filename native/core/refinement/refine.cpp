// SPDX-License-Identifier: BSD-3-Clause
#include "core/refinement/refine.h"

#include <algorithm>
#include <limits>

#include "core/refinement/fit_mixture.h"
#include "core/refinement/mixture.h"
#include "core/solvers/dense.h"

namespace epi360 {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kSameTolerance = 1e-2;  // of depths: relative change that counts as none
constexpr double kSettled = 3e-3;  // change of scale (relative) and shares that counts as none

RelativePose moved(const RelativePose& pose, const Eigen::Matrix<double, 3, 2>& basis,
                   const Vector5& step) {
  RelativePose next;
  next.R = exp_so3(step.head<3>()) * pose.R;
  next.t = (pose.t + basis * step.tail<2>()).normalized();
  return next;
}

double tolerance_of(const RefineOptions& options, const LossModel& loss) {
  return options.behind == Behind::kAsOthers ? kInfinity : depth_tolerance(loss.scale);
}

// Weights of all matches and what they cost together, with the given depths; the user's weights
// multiply both.
void weigh_matches(const Matches& m, const RefineOptions& options, const LossModel& loss,
                   const std::vector<double>& margins, Linearisation& at) {
  if (loss.loss == Loss::kMixture) {
    at.sums = mixture_pass(m, at.residuals.data(), margins.data(), at.tolerance,
                           options.behind == Behind::kNearMiss, loss, at.weights.data());
    at.objective = -at.sums.log_likelihood;
    return;
  }
  if (loss.loss == Loss::kGemanMcClure) {
    at.objective = geman_mcclure_pass(m, at.residuals.data(), margins.data(), at.tolerance,
                                      loss.scale, at.weights.data());
    return;
  }
  at.objective = 0.0;
  for (std::size_t i = 0; i < m.padded; ++i) {
    const LossValue value = evaluate_loss(at.residuals[i] * at.residuals[i], loss);
    at.weights[i] = m.weight[i] * value.weight;
    at.objective += m.weight[i] * value.cost;
  }
}

// The same, with what the prior costs in the unit of the loss.
void weigh(const Matches& m, const RefineOptions& options, const LossModel& loss,
           const RelativePose& pose, const std::vector<double>& margins, Linearisation& at) {
  weigh_matches(m, options, loss, margins, at);
  const double unit = loss.loss == Loss::kMixture ? 1.0 : 2.0 * loss.scale * loss.scale;
  if (options.prior.has_gravity) at.objective += unit * options.prior.cost(pose);
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

// With the depths of `margins`, which may be those of another pose.
void linearise(const Matches& m, const RefineOptions& options, const LossModel& loss,
               const RelativePose& pose, const std::vector<double>& margins, Linearisation& at) {
  const Eigen::Matrix<double, 3, 2, Eigen::RowMajor> basis = tangent_basis(pose.t);
  compute_jacobians(m, options.residual, plain(pose), basis.data(), at.residuals.data(),
                    at.margins.data(), at.jacobian.data());
  at.tolerance = tolerance_of(options, loss);
  weigh(m, options, loss, pose, margins, at);
}

// Whether a step is judged with the depths of the pose that it starts from, as of an expectation
// step. Those of the pose that it leads to would stop it wherever a match changes sides, which
// noise makes many do where it is so large that the tolerance is at its limit: then the pose with
// the most parallax wins, under which all lie in front for certain.
bool holds_depths(const RefineOptions& options, const LossModel& loss) {
  return options.behind == Behind::kOutlier && loss.loss == Loss::kMixture &&
         hides_depths(loss.scale);
}

// Whether a match lies in front at one pose and behind a camera at the other; counted, because a
// loop without an exit goes through vectors.
bool changes_sides(const std::vector<double>& before, const std::vector<double>& after,
                   double tolerance) {
  std::size_t num = 0;
  for (std::size_t i = 0; i < before.size(); ++i) {
    num += (before[i] > -tolerance) != (after[i] > -tolerance);
  }
  return num > 0;
}

}  // namespace

double depth_tolerance(double scale) { return std::min(3.0 * scale, kLargestWrongParallax); }

bool hides_depths(double scale) { return !(depth_tolerance(scale) < kLargestWrongParallax); }

PlainPose plain(const RelativePose& pose) {
  PlainPose p;
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(p.R) = pose.R;
  Eigen::Map<Eigen::Vector3d>(p.t) = pose.t;
  return p;
}

void Linearisation::resize(std::size_t padded) {
  for (auto* array : {&residuals, &margins, &weights}) array->resize(padded);
  jacobian.resize(5 * padded);
}

void RefineWorkspace::resize(std::size_t padded) {
  current.resize(padded);
  trial.resize(padded);
}

RefineResult refine(const Matches& m, const RelativePose& start, const RefineOptions& options,
                    RefineWorkspace& w) {
  w.resize(m.padded);
  RefineResult result;
  result.cam2_from_cam1 = start;
  // A long chain of products would drift away from orthonormality.
  result.cam2_from_cam1.R = Eigen::Quaterniond(start.R).normalized().toRotationMatrix();
  result.loss = options.loss;
  bool adaptive = options.loss.loss == Loss::kMixture;
  const auto weigh_again = [&] {
    weigh(m, options, result.loss, result.cam2_from_cam1, w.current.margins, w.current);
  };
  linearise(m, options, result.loss, result.cam2_from_cam1, w.current.margins, w.current);
  if (adaptive) {  // the start's mixture may come from other residuals
    update_mixture(w.current.sums, options, result.loss);
    weigh_again();
  }
  double damping = 1e-4;
  bool may_hold = true;  // depths, until the objective rises as matches change sides
  bool fresh = true;     // the weights are those of the loss
  for (int iteration = 0; iteration < options.max_iterations; ++iteration) {
    double upper[15];
    Vector5 gradient;
    accumulate_normal_equations(m.padded, w.current.jacobian.data(), w.current.residuals.data(),
                                w.current.weights.data(), upper, gradient.data());
    Matrix5 hessian = symmetric(upper);
    const Eigen::Matrix<double, 3, 2> basis = tangent_basis(result.cam2_from_cam1.t);
    options.prior.accumulate(result.cam2_from_cam1, basis, result.loss.scale * result.loss.scale,
                             hessian, gradient);
    // Pose and mixture step from one set of posterior probabilities (expectation conditional
    // maximisation); together they may only become more likely, unless depths are held.
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
    bool accepted = false;
    fresh = !updated;
    Vector5 step = Vector5::Zero();
    while (!accepted && damping < 1e8) {
      Matrix5 damped = hessian;
      damped.diagonal() *= 1.0 + damping;
      damped.diagonal().array() += 1e-15 * (1.0 + hessian.trace());
      step = -solve_symmetric(damped, gradient);
      if (!step.allFinite()) return result;
      if (step.norm() < options.step_tolerance) break;
      // -g.step = step^T H step: its squared length in units of the covariance scale^2 H^-1.
      if (-gradient.dot(step) < sigma * sigma) break;
      const RelativePose candidate = moved(result.cam2_from_cam1, basis, step);
      const bool held = may_hold && holds_depths(options, result.loss);
      linearise(m, options, result.loss, candidate, held ? w.current.margins : w.trial.margins,
                w.trial);
      if (w.trial.objective < w.current.objective) {
        result.cam2_from_cam1 = candidate;
        std::swap(w.current, w.trial);
        if (held && changes_sides(w.trial.margins, w.current.margins, w.current.tolerance)) {
          const double before = w.trial.objective;
          weigh_again();
          may_hold = w.current.objective <= before;  // else steps might go in circles
        }
        accepted = fresh = true;
        damping = std::max(damping * 0.1, 1e-9);
      } else if (!fresh) {  // limits on the shares can make the new mixture the less likely one
        weigh_again();
        fresh = true;
        if (w.trial.objective >= w.current.objective) damping *= 10.0;
      } else {
        damping *= 10.0;
      }
    }
    // Without a step that lowers the cost, at the depths it has, it is a minimum to working
    // precision.
    result.converged = !accepted || step.norm() < options.step_tolerance;
    if (result.converged) break;
  }
  // On the way the tolerance may be that of an earlier scale. Likelihoods can be compared only if
  // each is that of its own scale.
  const double tolerance = tolerance_of(options, result.loss);
  if (std::abs(tolerance - w.current.tolerance) > kSameTolerance * tolerance) {
    w.current.tolerance = tolerance;
    fresh = false;
  }
  if (!fresh) weigh_again();
  result.cost = w.current.objective;
  if (options.loss.loss == Loss::kMixture) {
    result.cost *= 2.0 * result.loss.scale * result.loss.scale;
  }
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

}  // namespace epi360
