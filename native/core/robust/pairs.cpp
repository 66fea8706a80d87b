// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/pairs.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <exception>
#include <limits>
#include <mutex>
#include <thread>
#include <utility>

#include "core/constants.h"
#include "core/robust/copies.h"
#include "core/robust/derivative_noise.h"
#include "core/robust/grid_noise.h"

namespace epi360 {
namespace {

constexpr double kWidestGate = 45.0 * kDegree;
constexpr double kNegligible = 1e-6;  // weight beside the heaviest
// Share of the matches that are copies, over which these are left out. Key points with two
// directions make fewer: 4 % of real matches, up to a fifth of rendered ones.
constexpr double kManyCopies = 0.25;

enum class Row { kUsable, kMissing, kInfinite, kZero };

// A bearing scaled to unit length.
Row unit_row(const double* row, double* unit) {
  double largest = 0.0;
  for (int k = 0; k < 3; ++k) largest = std::max(largest, std::abs(row[k]));
  if (!std::isfinite(row[0] + row[1] + row[2]) || !std::isfinite(largest)) {
    if (std::any_of(row, row + 3, [](double x) { return std::isinf(x); })) return Row::kInfinite;
    if (std::any_of(row, row + 3, [](double x) { return std::isnan(x); })) return Row::kMissing;
  }
  if (!(largest > 0.0)) return Row::kZero;
  double squared = 0.0;  // divided first, so that squares neither overflow nor vanish
  for (int k = 0; k < 3; ++k) {
    unit[k] = row[k] / largest;
    squared += unit[k] * unit[k];
  }
  const double norm = std::sqrt(squared);
  for (int k = 0; k < 3; ++k) unit[k] /= norm;
  return Row::kUsable;
}

bool finite_row(const double* row) {
  return std::all_of(row, row + 6, [](double x) { return std::isfinite(x); });
}

// The usable matches of a pair, and the match of every row that was given.
struct UsableMatches {
  static constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();

  Matches m;
  std::vector<std::size_t> match_of_row;  // kNone where the row is not usable
  std::vector<double> scores;
};

// Copies the usable rows; stops at one that nobody may give.
BadRow take_usable(const PairInput& input, UsableMatches& out) {
  const bool has_jacobians = input.jacobians1 && input.jacobians2;
  out.m = padding_matches(input.n, has_jacobians);
  out.match_of_row.assign(input.n, UsableMatches::kNone);
  std::size_t k = 0;
  for (std::size_t i = 0; i < input.n; ++i) {
    double unit1[3], unit2[3];
    const Row kinds[2] = {unit_row(input.bearings1 + 3 * i, unit1),
                          unit_row(input.bearings2 + 3 * i, unit2)};
    for (int view = 0; view < 2; ++view) {
      if (kinds[view] == Row::kInfinite || kinds[view] == Row::kZero) {
        return {view + 1, i, kinds[view] == Row::kInfinite};
      }
    }
    if (kinds[0] != Row::kUsable || kinds[1] != Row::kUsable) continue;
    if (input.weights && !(input.weights[i] > 0.0)) continue;
    if (input.scores && std::isnan(input.scores[i])) continue;
    if (input.jacobians1 && !finite_row(input.jacobians1 + 6 * i)) continue;
    if (input.jacobians2 && !finite_row(input.jacobians2 + 6 * i)) continue;
    set_bearings(out.m, k, unit1, unit2);
    out.m.weight[k] = input.weights ? input.weights[i] : 1.0;
    if (has_jacobians) set_jacobians(out.m, k, input.jacobians1 + 6 * i, input.jacobians2 + 6 * i);
    if (input.scores) out.scores.push_back(input.scores[i]);
    out.match_of_row[i] = k++;
  }
  truncate(out.m, k);
  return {};
}

// Leaves the matches of these indices. Match i of before is found at place_of[i], or not at all.
void keep(UsableMatches& usable, const std::vector<std::size_t>& kept,
          const std::vector<std::size_t>& place_of) {
  usable.m = chosen_matches(usable.m, kept);
  if (!usable.scores.empty()) {
    for (std::size_t k = 0; k < kept.size(); ++k) usable.scores[k] = usable.scores[kept[k]];
    usable.scores.resize(kept.size());
  }
  for (std::size_t& match : usable.match_of_row) {
    if (match != UsableMatches::kNone) match = place_of[match];
  }
}

// Where many matches repeat another one, each counts once, with the highest weight and score.
// Returns how many were copies.
std::size_t merge_copies(UsableMatches& usable) {
  Matches& m = usable.m;
  const std::vector<std::size_t> first = first_of_copies(m);
  std::vector<std::size_t> kept, place_of(m.size);
  for (std::size_t i = 0; i < m.size; ++i) {
    if (first[i] == i) {
      place_of[i] = kept.size();
      kept.push_back(i);
    } else {
      place_of[i] = place_of[first[i]];
    }
  }
  const std::size_t num_copies = m.size - kept.size();
  if (static_cast<double>(num_copies) <= kManyCopies * static_cast<double>(m.size)) return 0;
  for (std::size_t i = 0; i < m.size; ++i) {
    m.weight[first[i]] = std::max(m.weight[first[i]], m.weight[i]);
    if (usable.scores.empty()) continue;
    usable.scores[first[i]] = std::max(usable.scores[first[i]], usable.scores[i]);
  }
  keep(usable, kept, place_of);
  return num_copies;
}

// Weights are relative to one another: their sum becomes the number of matches of equal weight that
// say as much, (sum w)^2 / sum w^2 (Kish 1965), so that wherever weights are counted, evidence is.
// Matches that weigh next to nothing beside the heaviest are left out.
void normalise_weights(UsableMatches& usable) {
  Matches& m = usable.m;
  const double largest = *std::max_element(m.weight.begin(), m.weight.end());
  std::vector<std::size_t> kept;
  double sum = 0.0, squares = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    m.weight[i] /= largest;  // first, so that squares neither overflow nor vanish
    if (m.weight[i] < kNegligible) continue;
    kept.push_back(i);
    sum += m.weight[i];
    squares += m.weight[i] * m.weight[i];
  }
  if (kept.size() < m.size) {
    std::vector<std::size_t> place_of(m.size, UsableMatches::kNone);
    for (std::size_t k = 0; k < kept.size(); ++k) place_of[kept[k]] = k;
    keep(usable, kept, place_of);
  }
  for (std::size_t i = 0; i < m.size; ++i) {
    m.weight[i] *= sum / squares;
    m.unit_weights = m.unit_weights && m.weight[i] == 1.0;
  }
}

// Divides Jacobians by their root mean square, so that residuals in pixels become angles. Returns
// that number, 1 where there is none: Jacobians of zero say nothing of pixels.
double normalise_jacobians(Matches& m) {
  double largest = 0.0, squares = 0.0;
  for (const auto& columns : {jacobian_columns(m, 1), jacobian_columns(m, 2)}) {
    for (const std::vector<double>* column : columns) {
      for (std::size_t i = 0; i < m.size; ++i) largest = std::max(largest, std::abs((*column)[i]));
    }
  }
  if (!(largest > 0.0)) return 1.0;
  for (const auto& columns : {jacobian_columns(m, 1), jacobian_columns(m, 2)}) {
    for (std::size_t i = 0; i < m.size; ++i) {
      for (const std::vector<double>* column : columns) {
        const double ratio = (*column)[i] / largest;  // so that squares neither overflow nor vanish
        squares += ratio * ratio;
      }
    }
  }
  const double mean = std::sqrt(squares / (4.0 * static_cast<double>(m.size)));
  for (const auto& columns : {jacobian_columns(m, 1), jacobian_columns(m, 2)}) {
    for (std::vector<double>* column : columns) {
      for (std::size_t i = 0; i < m.size; ++i) (*column)[i] = (*column)[i] / largest / mean;
    }
  }
  return largest * mean;
}

// One entry for every row that was given.
template <typename T>
std::vector<T> spread_out(const std::vector<T>& values,
                          const std::vector<std::size_t>& match_of_row, T missing) {
  std::vector<T> all;
  all.reserve(match_of_row.size());
  for (const std::size_t match : match_of_row) {
    all.push_back(match == UsableMatches::kNone ? missing : values[match]);
  }
  return all;
}

PairResult estimate_pair(const PairInput& input, const RobustOptions& options) {
  PairResult out;
  UsableMatches usable;
  out.bad_row = take_usable(input, usable);
  if (out.bad_row.view) return out;
  const std::size_t num_copies = merge_copies(usable);
  if (input.weights && usable.m.size > 0) normalise_weights(usable);
  const double pixel = usable.m.has_jacobians() ? normalise_jacobians(usable.m) : 1.0;
  RobustOptions scaled = options;
  if (options.threshold_in_pixels) {
    scaled.threshold = std::min(pixel * options.threshold, kWidestGate);
  }
  MatchPriors priors;
  priors.scores = std::move(usable.scores);
  if (input.gravity1 && input.gravity2) {
    priors.pose.has_gravity = true;
    priors.pose.gravity1 = Eigen::Map<const Eigen::Vector3d>(input.gravity1).normalized();
    priors.pose.gravity2 = Eigen::Map<const Eigen::Vector3d>(input.gravity2).normalized();
    priors.pose.gravity_sigma = input.gravity_sigma;
    priors.pose.elevation_sigma = input.elevation_sigma;
  }
  priors.max_noise = input.max_noise;
  const double per_residual = noise_per_residual(options.residual);
  usable.m.least_scale = std::max(usable.m.least_scale, input.min_noise / per_residual);
  RobustResult& r = out.robust;
  const RowCounts rows{input.n, num_copies};
  r = estimate_relative_pose(usable.m, scaled, priors, input.seed, rows);
  const double least = least_scale_of_grid(usable.m, options.residual, r);
  if (least > usable.m.least_scale) {
    usable.m.least_scale = least;
    r = estimate_relative_pose(usable.m, scaled, priors, input.seed, rows);
  }
  r.inlier = spread_out<unsigned char>(r.inlier, usable.match_of_row, 0);
  r.residuals = spread_out<double>(r.residuals, usable.match_of_row, std::nan(""));
  return out;
}

}  // namespace

std::vector<PairResult> estimate_pairs(const std::vector<PairInput>& pairs,
                                       const RobustOptions& options, int num_threads) {
  std::vector<PairResult> results(pairs.size());
  std::atomic<std::size_t> next{0};
  std::mutex mutex;
  std::exception_ptr failure;
  const auto work = [&] {
    try {
      for (std::size_t i = next++; i < pairs.size(); i = next++) {
        const auto start = std::chrono::steady_clock::now();
        results[i] = estimate_pair(pairs[i], options);
        results[i].seconds =
            std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
      }
    } catch (...) {  // out of memory: the caller hears of it once all threads have stopped
      const std::lock_guard<std::mutex> lock(mutex);
      failure = std::current_exception();
      next = pairs.size();
    }
  };
  std::vector<std::thread> helpers;
  const std::size_t wanted = std::min(pairs.size(), static_cast<std::size_t>(num_threads));
  try {
    for (std::size_t k = 1; k < wanted; ++k) helpers.emplace_back(work);
  } catch (const std::exception&) {  // no more threads or memory for them: those at hand do it all
  }
  work();
  for (std::thread& helper : helpers) helper.join();
  if (failure) std::rethrow_exception(failure);
  return results;
}

}  // namespace epi360
