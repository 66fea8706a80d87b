// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/estimate.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "core/robust/around_camera.h"
#include "core/robust/conclusion.h"
#include "core/robust/covariance.h"
#include "core/robust/crowd.h"
#include "core/robust/derivative_noise.h"
#include "core/robust/evidence.h"
#include "core/robust/fixed_content.h"
#include "core/robust/inliers.h"
#include "core/robust/leverage.h"
#include "core/robust/matches_left.h"
#include "core/robust/one_side.h"
#include "core/robust/rival.h"
#include "core/robust/rival_search.h"
#include "core/robust/rotation_search.h"
#include "core/robust/rotation_test.h"
#include "core/robust/search.h"
#include "core/robust/shared_error.h"
#include "core/robust/testimony.h"
#include "core/robust/upright_search.h"

namespace epi360 {
namespace {

// Probability that the gravity which a user gives belongs to these images.
constexpr double kGravityIsRight = 0.99;
constexpr int kUprightPoses = 4;  // of all that are tried
constexpr double kNarrow = 0.15 * kDegree, kPolished = 1e-4;
constexpr int kPolishings = 50;
constexpr std::size_t kOtherCandidates = 8;
// Where residuals of wrong matches are counted: as many as tell their density to a seventh.
constexpr double kChanceRange = 2.0 * kDegree;
// A search for rivals may draw one sample for so many of the first search; more where scores have
// led that one, which ends as soon as the best scored matches agree. A rival is compared with
// the pose if it has at least this share of the pose's support before it is refined by all matches,
// and is no more than so much less likely after that.
constexpr int kFirstSearch = 4, kMostBesideScores = 2000;
constexpr double kCompetingSupport = 0.25, kCompetingEvidence = 30.0;
// Times that inliers of a pose beside a rotation must be more than wrong matches explain.
constexpr double kMoreThanChance = 3.0;
constexpr double kMostlyOwn = 0.5;   // share of a rival's matches that the pose does not explain
constexpr double kConfident = 0.99;  // a pose more probable than this is not looked for again

// A pose is worth more than a rotation, and that more than neither.
int worth(const RobustResult& result) {
  const Status status = judge(result.evidence).status;
  return status == Status::kOk ? 2 : status == Status::kPureRotation ? 1 : 0;
}

// Regions that a pose leaves, over those that agree with it.
double regions_left(const Evidence& e) {
  return (e.all_regions - e.num_regions) / std::max(e.num_regions, 1.0);
}

// Whether a later answer takes the place of an earlier one.
bool is_better(const RobustResult& later, const RobustResult& earlier) {
  if (worth(later) != worth(earlier)) return worth(later) > worth(earlier);
  return later.probability > earlier.probability;
}

// The estimate of one set of matches, from its search to its verdict.
class Estimate {
 public:
  // `known` says where down is, also to a search that gravity does not guide.
  Estimate(const Matches& m, const RobustOptions& options, const MatchPriors& priors,
           const PosePrior& known, std::uint64_t seed)
      : m_(m),
        options_(options),
        priors_(priors),
        prior_(priors.pose),
        known_(known),
        random_(seed),
        seed_(seed) {
    start_over();
    if (status() == Status::kTooFewMatches) return;
    SearchResult found = search_poses(m, options, priors_, random_);
    result_.num_iterations = found.num_iterations;
    conclude_search(found.candidates);
  }

  // Where samples led to nothing certain and gravity is known, all upright poses are tried.
  void try_upright_poses() {
    if (status() == Status::kTooFewMatches || is_certain()) return;
    Candidates candidates(m_, options_.residual, prior_);
    candidates.set_depth_tolerance(default_gate());
    LossModel narrow;  // one Gaussian, which does not spread over near misses
    narrow.loss = Loss::kMixture;
    narrow.scale = kNarrow;
    std::fill(std::begin(narrow.share), std::end(narrow.share), 0.0);
    narrow.share[0] = 0.3;
    for (const RelativePose& pose : upright_poses(m_, prior_, kUprightPoses)) {
      candidates.polish(pose, kPolishings, kPolished);
      candidates.polish(candidates.annealed(pose, narrow.scale), kPolishings, kPolished, &narrow);
    }
    const RobustResult sampled = std::move(result_);
    start_over(sampled.num_iterations);
    prefer_most_probable(candidates);
    conclude_search(candidates);
    if (!is_better(result_, sampled)) result_ = sampled;
  }

  // A pose was found: nothing else need be tried. A rotation may be a wide optimum that the search
  // among upright poses ended in.
  bool has_answer() const { return status() == Status::kOk; }

  // The pose is judged by a prior that did not guide its search.
  void judge_by(const PosePrior& prior) {
    if (!has_translation(status())) return;
    weigh_by(prior);
    result_.probability = probability_of_pose(result_.evidence);
  }

  RobustResult take() { return std::move(result_); }

 private:
  Status status() const { return judge(result_.evidence).status; }

  bool is_certain() const { return has_answer() && result_.probability > kConfident; }

  void start_over(int num_iterations = 0) {
    result_ = RobustResult{};
    result_.num_iterations = num_iterations;
    result_.inlier.assign(m_.size, 0);
    result_.residuals.assign(m_.padded, RobustResult::kNaN);
    result_.covariance.setConstant(RobustResult::kNaN);
    if (options_.threshold > 0.0) result_.threshold = options_.threshold;
    result_.evidence.num_usable = static_cast<int>(m_.size);
    result_.evidence.num_effective =
        static_cast<int>(std::lround(std::accumulate(m_.weight.begin(), m_.weight.end(), 0.0)));
    result_.evidence.sample_size = options_.sample_size;
    result_.evidence.has_prior = prior_.has_gravity;
    dropped_.assign(m_.size, 0);
  }

  void conclude_search(Candidates& candidates) {
    settle(candidates);
    if (has_answer()) settle_with_rivals(candidates);
    if (lacks_direction(result_.evidence)) try_other_candidates(candidates);
  }

  // The answer beside what the matches say that it leaves, if they say anything.
  void settle_with_rivals(Candidates& candidates) {
    const RivalsLeft found = find_rivals_left(candidates);
    if (found == RivalsLeft::kNone) return;
    RobustResult first = std::move(result_);
    std::vector<unsigned char> dropped = std::move(dropped_);
    start_over(first.num_iterations);
    settle(candidates);
    // What the regions prefer must be a pose itself.
    if (found != RivalsLeft::kPreferred || has_translation(status())) return;
    first.num_iterations = result_.num_iterations;
    result_ = std::move(first);
    dropped_ = std::move(dropped);
  }

  // The best candidate as it is reported, with its verdict.
  void settle(Candidates& candidates) {
    candidates.allow_near_misses();
    release_depths(m_, options_.residual, candidates);
    candidates.simplify();
    dropped_ = drop_leverage(m_, options_.residual, candidates);
    assess(candidates);
  }

  // What the matches that an accepted pose leaves say: nothing, a pose that may compete with it, or
  // one with which fewer matches agree, but far more regions.
  enum class RivalsLeft { kNone, kCompeting, kPreferred };
  RivalsLeft find_rivals_left(Candidates& candidates) {
    const int least = priors_.scores.empty() ? 0 : kMostBesideScores;
    const int most = std::max(result_.num_iterations / kFirstSearch, least);
    const RivalSearchResult found =
        search_rivals(m_, options_, priors_, result_.inlier, result_.threshold,
                      regions_left(result_.evidence), most, random_);
    result_.num_iterations += found.num_iterations;
    if (found.poses.empty()) return RivalsLeft::kNone;
    Candidates others(m_, options_.residual, prior_);
    others.set_depth_tolerance(candidates.depth_tolerance());
    std::vector<unsigned char> inlier;
    std::vector<double> residuals;
    for (const RelativePose& pose : found.poses) {
      const double support =
          mark_inliers(m_, options_.residual, pose, result_.threshold, true, inlier, residuals);
      if (support < kCompetingSupport * result_.evidence.support) continue;
      others.polish(pose, kPolishings, kPolished);
    }
    if (others.empty()) return RivalsLeft::kNone;
    // What the pose was moved by since it was a candidate may have made it more likely.
    Candidates same(m_, options_.residual, prior_);
    same.set_depth_tolerance(candidates.depth_tolerance());
    const Candidate moved = same.polish(result_.cam2_from_cam1, kPolishings, kPolished);
    if (moved.evidence > candidates.best().evidence) candidates.replace_best(moved);
    const Candidate first = candidates.best();
    const Evidence own = heard(first.cam2_from_cam1, first.loss);
    bool competes = false;
    const Candidate* preferred = nullptr;
    double highest = 1.0;
    for (const Candidate& rival : others.all()) {
      const double lead = rival.evidence - first.evidence;
      const double odds =
          odds_of_rival(evidence_beside({rival.cam2_from_cam1, rival.loss, lead}, own, first.loss));
      if (lead < -kCompetingEvidence && !(odds > 0.0)) continue;
      competes = candidates.add(rival) || competes;
      if (!(odds > highest)) continue;
      highest = odds;
      preferred = &rival;
    }
    const bool is_preferred = preferred && candidates.prefer(*preferred);
    if (competes || is_preferred) candidates.give_up_blurred();
    if (is_preferred) return RivalsLeft::kPreferred;
    return competes ? RivalsLeft::kCompeting : RivalsLeft::kNone;
  }

  // The most likely candidate that has a direction, if there is one.
  void try_other_candidates(Candidates& candidates) {
    const RobustResult first = std::move(result_);
    const std::vector<unsigned char> dropped = dropped_;
    const Candidates all = candidates;  // assessing one may add and reorder
    const std::size_t most = std::min<std::size_t>(all.all().size(), kOtherCandidates);
    for (std::size_t k = 1; k < most; ++k) {
      start_over(first.num_iterations);
      Candidates preferred = all;
      preferred.prefer(k);
      assess(preferred);
      if (status() == Status::kOk) return;
    }
    result_ = first;
    dropped_ = dropped;
  }

  // Puts the candidate first for which the regions speak most.
  void prefer_most_probable(Candidates& candidates) {
    std::size_t best = 0;
    double highest = -1.0;
    for (std::size_t k = 0; k < candidates.all().size(); ++k) {
      const Candidate& candidate = candidates.all()[k];
      Evidence evidence;
      listen(candidate.cam2_from_cam1, candidate.loss.scale, gate_of_mixture(candidate.loss),
             candidate.loss.outlier_density, evidence);
      if (probability_by_regions(evidence) <= highest) continue;
      highest = probability_by_regions(evidence);
      best = k;
    }
    if (!candidates.empty()) candidates.prefer(best);
  }

  double gate_of_mixture(const LossModel& mixture) const {
    return options_.threshold > 0.0 ? options_.threshold : estimated_gate(mixture);
  }

  void listen(const RelativePose& pose, double scale, double gate, double density,
              Evidence& evidence) {
    const Testimony said =
        testimony(m_, options_.residual, pose, scale, gate, density, known_, seed_);
    evidence.log_ratio = said.log_ratio;
    evidence.regional_sigma = said.direction_sigma;
    evidence.num_regions = said.num_regions;
    evidence.all_regions = said.all_regions;
  }

  // The tilt of the answer against gravity, and the logarithm of its prior, as far as that may
  // lower the odds: a search among upright poses finds upright ones, so that being one is no
  // evidence.
  void weigh_by(const PosePrior& prior) {
    if (!prior.has_gravity) return;
    const RelativePose& pose = result_.cam2_from_cam1;
    Evidence& evidence = result_.evidence;
    evidence.log_prior =
        std::log(kGravityIsRight * std::exp(-prior.cost(pose)) + 1.0 - kGravityIsRight);
    evidence.tilt = direction_angle(pose.R * prior.gravity1, prior.gravity2);
    evidence.tilt_sigma = std::sqrt(2.0) * prior.gravity_sigma;
  }

  // Inliers, evidence and uncertainty of the best candidate, or of a rotation in its place.
  void assess(Candidates& candidates) {
    mark(candidates);
    Evidence& evidence = result_.evidence;
    const double gate = result_.threshold;
    const ChanceDensity chance(m_, options_.residual, seed_);
    RotationFit rotation;
    const auto find_rotation = [&] {
      rotation = best_rotation(m_, gate, random_);
      rotation.wrong = chance.rotation_share(rotation.R, gate);
      evidence.rotation_support = rotation.support;
      evidence.rotation_log10_false_alarms = log10_false_alarms(
          evidence.num_effective, rotation.support, rotation.wrong, kRotationSample);
    };
    if (candidates.empty() ||
        rotation_possible(m_, result_.inlier, evidence.support, gate, random_)) {
      find_rotation();
    }
    density_ = candidates.empty() ? kTypicalDensity
                                  : chance.at(result_.cam2_from_cam1, std::max(kChanceRange, gate));
    evidence.chance = 2.0 * gate * density_;
    evidence.log10_false_alarms = log10_false_alarms(evidence.num_effective, evidence.support,
                                                     evidence.chance, options_.sample_size);
    if (status() == Status::kTooFewInliers) {  // no pose; a rotation may be one all the same
      evidence.rotation_rejection = 0.0;
      if (status() == Status::kPureRotation) set_rotation(std::move(rotation));
      return;
    }
    const Uncertainty uncertainty = pose_uncertainty(
        m_, options_.residual, result_.cam2_from_cam1, candidates.best().loss, gate, result_.inlier,
        dropped_, result_.residuals, prior_, options_.shared_error, wrong_inliers());
    result_.scale = evidence.scale = uncertainty.scale;
    if (m_.least_scale > kSmallestScale) {
      evidence.scale = std::max(uncertainty.scale, m_.least_scale);
    }
    set_covariance(uncertainty.covariance);
    evidence.parallax = median_parallax(m_, result_.cam2_from_cam1, result_.inlier.data());
    result_.parallax = evidence.parallax;
    if (has_hardly_any_parallax(evidence) && rotation.support == 0) find_rotation();
    if (rotation_explains(evidence)) {
      const RotationTest test = test_rotation(m_, result_.inlier, rotation.R, uncertainty.scale,
                                              gate, shared_errors(uncertainty));
      evidence.rotation_rejection = test.by_median;
      if (test.all_around) {
        evidence.rotation_rejection = std::max(test.by_median, test.by_displaced);
      }
      evidence.displaced_rejection = test.by_displaced;
      evidence.num_displaced = test.num_displaced;
      if (status() == Status::kPureRotation) return set_rotation(std::move(rotation));
    }
    listen(result_.cam2_from_cam1, uncertainty.scale, gate, density_, evidence);
    weigh_by(prior_);
    const Rivals rivals = find_rivals(m_, candidates, result_.cam2_from_cam1,
                                      uncertainty.covariance, result_.inlier, gate);
    evidence.plane_share = rivals.plane_share;
    evidence.has_twin = rivals.has_twin;
    if (!rivals.nearby.empty() || rivals.distant) {
      const LossModel& loss = candidates.best().loss;
      const Evidence own = heard(result_.cam2_from_cam1, loss);
      span_nearby(rivals.nearby, own, loss);
      if (rivals.distant) {
        evidence = evidence_beside(*rivals.distant, own, loss);
        count_own(rivals.distant->cam2_from_cam1);
      }
    }
    result_.probability = probability_of_pose(evidence);
    if (status() == Status::kPlanarAmbiguous) {
      result_.alternatives = {rivals.distant->cam2_from_cam1};
    }
  }

  // How many wrong matches are expected among the inliers, which agree with them by chance.
  double wrong_inliers() const {
    const Evidence& e = result_.evidence;
    if (!(e.chance < 1.0)) return 0.0;
    return std::max(e.num_effective - e.support, 0) * e.chance / (1.0 - e.chance);
  }

  // What the inliers of a pose are wrong by together. Of the two components of a shared error that
  // pose may have hidden one: it is the epipolar lines along which most of it goes.
  NeighbourErrors shared_errors(const Uncertainty& uncertainty) const {
    NeighbourErrors errors{1.0 / uncertainty.clustering, 0.5 * uncertainty.shared};
    if (!(errors.hidden > 0.0)) return errors;
    const double share = independent_share(m_, result_.inlier, uncertainty.shared);
    if (share < errors.independent) errors.independent = share;
    return errors;
  }

  // Adds what the covariance does not know of poses near by that may be right as well.
  void span_nearby(const std::vector<Rival>& nearby, const Evidence& own, const LossModel& loss) {
    std::vector<double> odds;
    double total = 1.0;  // those of the pose itself
    for (const Rival& rival : nearby) {
      odds.push_back(odds_of_rival(evidence_beside(rival, own, loss)));
      total += odds.back();
    }
    Eigen::Matrix<double, 5, 5> covariance = result_.covariance;
    for (std::size_t k = 0; k < nearby.size(); ++k) {
      if (odds[k] > 0.0) {
        covariance +=
            second_moment(result_.cam2_from_cam1, nearby[k].cam2_from_cam1, odds[k] / total);
      }
    }
    set_covariance(covariance);
  }

  void set_covariance(const Eigen::Matrix<double, 5, 5>& covariance) {
    Evidence& evidence = result_.evidence;
    result_.covariance = covariance;
    evidence.rotation_sigma = rotation_sigma(covariance);
    evidence.direction_sigma = direction_sigma(covariance);
  }

  // What the regions say of a candidate.
  Evidence heard(const RelativePose& pose, const LossModel& loss) {
    Evidence evidence;
    listen(pose, loss.scale, gate_of_mixture(loss), density_, evidence);
    return evidence;
  }

  // The evidence so far, with what speaks for another pose than the one of this mixture, of which
  // the regions say `own`. With more noise more regions agree, which is no evidence for it.
  Evidence evidence_beside(const Rival& rival, const Evidence& own, const LossModel& loss) {
    const Evidence other = heard(rival.cam2_from_cam1, rival.loss);
    Evidence beside = result_.evidence;
    beside.rival_probability = probability_by_regions(other);
    beside.rival_regions = lead_by_regions(own, other);
    if (is_sharper(loss, rival.loss)) beside.rival_regions = std::max(beside.rival_regions, 0.0);
    beside.only_pose = beside.only_rival = 0.0;  // not counted yet
    beside.rival_evidence = rival.evidence;
    return beside;
  }

  // Matches that only the answer, and only another motion, explains, if that rests on its own ones.
  void count_own(const RelativePose& other) {
    std::vector<unsigned char> inlier;
    std::vector<double> residuals;
    const double support =
        mark_inliers(m_, options_.residual, other, result_.threshold, true, inlier, residuals);
    double only_pose = 0.0, only_rival = 0.0;
    for (std::size_t i = 0; i < m_.size; ++i) {
      if (inlier[i] == result_.inlier[i]) continue;
      (inlier[i] ? only_rival : only_pose) += m_.weight[i];
    }
    if (only_rival < kMostlyOwn * support) return;
    result_.evidence.only_pose = only_pose;
    result_.evidence.only_rival = only_rival;
  }

  // The pose of the best candidate, its gate and its inliers.
  void mark(const Candidates& candidates) {
    RobustResult& r = result_;
    if (!(options_.threshold > 0.0)) {
      r.threshold = candidates.empty() ? default_gate() : estimated_gate(candidates.best().loss);
    }
    if (candidates.empty()) return;
    r.cam2_from_cam1 = candidates.best().cam2_from_cam1;
    const auto inliers = [&](bool use_depths) {
      return mark_inliers(m_, options_.residual, r.cam2_from_cam1, r.threshold, use_depths,
                          r.inlier, r.residuals, &r.evidence.behind);
    };
    inliers(false);
    decide_cheirality(m_, r.inlier, r.cam2_from_cam1);
    double support = inliers(true);
    for (std::size_t i = 0; i < m_.size; ++i) {
      if (r.inlier[i] && dropped_[i]) support -= m_.weight[i];
      r.inlier[i] = r.inlier[i] && !dropped_[i];
    }
    r.evidence.support = static_cast<int>(std::lround(support));
    r.evidence.mirrored_turn = weight_of_mirrored_turn(m_, r.cam2_from_cam1, r.threshold);
  }

  // Share of the cells with an inlier of the pose that was found, if far more of these than chance
  // explains do not agree with the rotation, and what agrees lies on one side.
  double coverage_beside(const RotationFit& rotation) const {
    const RobustResult& r = result_;
    const double beside = static_cast<double>(r.evidence.support) - rotation.support;
    if (!(beside > kMoreThanChance * wrong_inliers())) return 0.0;
    std::vector<std::size_t> agreeing;
    for (std::size_t i = 0; i < m_.size; ++i) {
      if (rotation.residuals[i] < r.threshold) agreeing.push_back(i);
    }
    if (are_all_around(m_, agreeing)) return 0.0;
    return extents(m_, r.inlier.data()).chosen.coverage;
  }

  void set_rotation(RotationFit rotation) {
    RobustResult& r = result_;
    r.cam2_from_cam1 = {rotation.R, Eigen::Vector3d::UnitZ()};
    r.evidence.pose_coverage = coverage_beside(rotation);
    r.residuals = std::move(rotation.residuals);
    for (std::size_t i = 0; i < m_.size; ++i) r.inlier[i] = r.residuals[i] < r.threshold;
    const Uncertainty uncertainty = rotation_uncertainty(m_, r.inlier, r.residuals);
    r.scale = uncertainty.scale;
    r.covariance = uncertainty.covariance;
    r.evidence.rotation_log_ratio =
        rotation_log_ratio(m_, rotation.R, r.scale, r.threshold, rotation.wrong, seed_);
    r.evidence.turn_sigma = rotation_sigma(uncertainty.covariance);
    r.parallax = median_parallax(m_, r.cam2_from_cam1, r.inlier.data());
    r.probability = RobustResult::kNaN;
  }

  const Matches& m_;
  const RobustOptions& options_;
  const MatchPriors& priors_;
  const PosePrior prior_, known_;
  Random random_;
  std::uint64_t seed_;
  std::vector<unsigned char> dropped_;
  double density_ = kTypicalDensity;  // of wrong residuals, under the last pose that was assessed
  RobustResult result_;
};

// The answer of these matches, found with gravity and, where that leads to none, without.
RobustResult estimate_all(const Matches& m, const RobustOptions& options, const MatchPriors& priors,
                          std::uint64_t seed) {
  Estimate estimate(m, options, priors, priors.pose, seed);
  if (priors.pose.has_gravity) estimate.try_upright_poses();
  if (!priors.pose.has_gravity || estimate.has_answer()) return estimate.take();
  MatchPriors free = priors;
  free.pose = PosePrior{};
  RobustResult result = estimate.take();
  Estimate again(m, options, free, priors.pose, seed);
  again.judge_by(priors.pose);
  const int num_iterations = result.num_iterations;
  RobustResult other = again.take();
  other.num_iterations += num_iterations;
  if (is_better(other, result)) return other;
  result.num_iterations = other.num_iterations;
  return result;
}

// The answer of all matches; where it is a pose whose inliers crowd, one match of each region is
// asked whether it says something else.
RobustResult estimate_confirmed(const Matches& m, const RobustOptions& options,
                                const MatchPriors& priors, std::uint64_t seed) {
  RobustResult result = estimate_all(m, options, priors, seed);
  const bool has_pose = judge(result.evidence).status == Status::kOk;
  if (!has_pose || !inliers_crowd(result.evidence)) return result;
  const MatchesLeft few = one_for_each_region(m, priors, seed);
  const RobustResult regions = estimate_all(few.m, options_of_regions(options), few.priors, seed);
  result.num_iterations += regions.num_iterations;
  result.evidence.is_only_crowd = regions_contradict(few.m, options.residual, regions, result);
  return result;
}

// The answer, or that of what lies around the camera if this contradicts one side, whose pose is
// then the first alternative.
RobustResult without_one_side(const Matches& m, const RobustOptions& options,
                              const MatchPriors& priors, std::uint64_t seed, const RowCounts& rows,
                              RobustResult result) {
  if (result.verdict.status != Status::kOk) return result;
  for (const Side& side : sides_to_ask(m, options, priors, seed, result)) {
    const MatchesLeft left = without(m, priors, side.rows);
    RobustResult others =
        estimate_confirmed(left.m, options_beside(side, options), left.priors, seed);
    result.num_iterations += others.num_iterations;
    RobustResult alone = others;
    conclude(left.m, options, rows, priors.max_noise, alone);
    if (!contradicts(m, side, left, alone, result)) continue;
    others.num_iterations = result.num_iterations;
    others.evidence.num_contradicting = static_cast<int>(side.rows.size());
    conclude(left.m, options, rows, priors.max_noise, others);
    // What is said first of a turn in part is the turn.
    const bool has_answer = others.verdict.status != Status::kConcentratedInliers;
    others.alternatives.insert(has_answer ? others.alternatives.begin() : others.alternatives.end(),
                               result.cam2_from_cam1);
    return on_all(m, left, std::move(others), options.residual);
  }
  return result;
}

}  // namespace

RobustResult estimate_relative_pose(const Matches& m, const RobustOptions& options,
                                    const MatchPriors& priors, std::uint64_t seed,
                                    const RowCounts& rows) {
  RobustResult result = estimate_confirmed(m, options, priors, seed);
  conclude(m, options, rows, priors.max_noise, result);
  const std::vector<std::size_t> fixed = maybe_fixed(m, result);
  if (fixed.empty()) return without_one_side(m, options, priors, seed, rows, std::move(result));
  const MatchesLeft left = without(m, priors, fixed);
  RobustResult other = estimate_confirmed(left.m, options, left.priors, seed);
  other.num_iterations += result.num_iterations;
  result.num_iterations = other.num_iterations;
  other.evidence.num_fixed = static_cast<int>(fixed.size());
  conclude(left.m, options, rows, priors.max_noise, other);
  const OthersSay say = others_say(m, fixed, left, result, other, options.residual);
  if (say == OthersSay::kFixed) return on_all(m, left, std::move(other), options.residual);
  if (say == OthersSay::kPose && result.verdict.status == Status::kPureRotation) {
    const auto agreeing = std::count(other.inlier.begin(), other.inlier.end(), 1);
    result.verdict.warnings.push_back({WarningCode::kMotionBeside, static_cast<double>(agreeing),
                                       static_cast<double>(fixed.size())});
    result.alternatives.insert(result.alternatives.begin(), other.cam2_from_cam1);
  }
  return result;
}

}  // namespace epi360
