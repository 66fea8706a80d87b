// SPDX-License-Identifier: BSD-3-Clause
#include "pair.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>

namespace epi360 {
namespace {

using Clock = std::chrono::steady_clock;

constexpr double kWidest = 0.7853981633974483;  // radians: the widest gate

enum class Row { kUsable, kMissing, kInfinite, kZero };

// A bearing scaled to unit length.
Row unit_row(const double* row, double* unit) {
  double largest = 0.0;
  bool missing = false, infinite = false;
  for (int k = 0; k < 3; ++k) {
    missing = missing || std::isnan(row[k]);
    infinite = infinite || std::isinf(row[k]);
    largest = std::max(largest, std::abs(row[k]));
  }
  if (infinite) return Row::kInfinite;
  if (missing) return Row::kMissing;
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

// Usable rows of a pair, packed.
struct Packed {
  std::vector<std::size_t> rows;
  std::vector<double> bearings1, bearings2, weights, scores, jacobians1, jacobians2;
};

bool pack(const RawPair& raw, Packed& packed, PairResult& out) {
  packed.rows.reserve(raw.n);
  packed.bearings1.reserve(3 * raw.n);
  packed.bearings2.reserve(3 * raw.n);
  for (std::size_t i = 0; i < raw.n; ++i) {
    double unit1[3], unit2[3];
    const Row rows[2] = {unit_row(raw.bearings1 + 3 * i, unit1),
                         unit_row(raw.bearings2 + 3 * i, unit2)};
    for (int view = 0; view < 2; ++view) {
      if (rows[view] != Row::kInfinite && rows[view] != Row::kZero) continue;
      out.bad_view = view + 1;
      out.bad_row = i;
      out.is_infinite = rows[view] == Row::kInfinite;
      return false;
    }
    if (rows[0] != Row::kUsable || rows[1] != Row::kUsable) continue;
    if (raw.weights && !(raw.weights[i] > 0.0)) continue;
    if (raw.scores && std::isnan(raw.scores[i])) continue;
    if (raw.jacobians1 && !finite_row(raw.jacobians1 + 6 * i)) continue;
    if (raw.jacobians2 && !finite_row(raw.jacobians2 + 6 * i)) continue;
    packed.rows.push_back(i);
    packed.bearings1.insert(packed.bearings1.end(), unit1, unit1 + 3);
    packed.bearings2.insert(packed.bearings2.end(), unit2, unit2 + 3);
    if (raw.weights) packed.weights.push_back(raw.weights[i]);
    if (raw.scores) packed.scores.push_back(raw.scores[i]);
    if (!raw.jacobians1) continue;
    packed.jacobians1.insert(packed.jacobians1.end(), raw.jacobians1 + 6 * i,
                             raw.jacobians1 + 6 * (i + 1));
    packed.jacobians2.insert(packed.jacobians2.end(), raw.jacobians2 + 6 * i,
                             raw.jacobians2 + 6 * (i + 1));
  }
  return true;
}

// Weights are relative to one another; Jacobians are divided by their root mean square, so that
// residuals in pixels become angles. Returns that number.
double normalise(Packed& packed) {
  double largest = 0.0, sum = 0.0;
  for (const double w : packed.weights) largest = std::max(largest, w);
  for (double& w : packed.weights) sum += w /= largest;
  for (double& w : packed.weights) w *= static_cast<double>(packed.rows.size()) / sum;
  if (packed.jacobians1.empty()) return 1.0;
  double squares = 0.0;
  for (const std::vector<double>* J : {&packed.jacobians1, &packed.jacobians2}) {
    for (const double x : *J) squares += x * x;
  }
  const double scale = std::sqrt(squares / (4.0 * static_cast<double>(packed.rows.size())));
  for (std::vector<double>* J : {&packed.jacobians1, &packed.jacobians2}) {
    for (double& x : *J) x /= scale;
  }
  return scale;
}

// One minus the length of the mean bearing.
double spread_of(const std::vector<double>& bearings, const std::vector<unsigned char>* chosen) {
  double mean[3] = {0.0, 0.0, 0.0}, count = 0.0;
  for (std::size_t i = 0; 3 * i < bearings.size(); ++i) {
    if (chosen && !(*chosen)[i]) continue;
    for (std::size_t k = 0; k < 3; ++k) mean[k] += bearings[3 * i + k];
    count += 1.0;
  }
  if (count == 0.0) return 0.0;
  return 1.0 - std::sqrt(mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2]) / count;
}

// Inliers that are no copies of one another, told apart by one projection.
int count_distinct(const Packed& packed, const std::vector<unsigned char>& chosen) {
  static constexpr double kProjection[6] = {0.6180, 0.7549, 0.8192, 1.3247, 1.2207, 1.1673};
  std::vector<double> values;
  for (std::size_t i = 0; i < packed.rows.size(); ++i) {
    if (!chosen[i]) continue;
    double value = 0.0;
    for (std::size_t k = 0; k < 3; ++k) {
      value += packed.bearings1[3 * i + k] * kProjection[k] +
               packed.bearings2[3 * i + k] * kProjection[3 + k];
    }
    values.push_back(std::round(value * 1e12));
  }
  std::sort(values.begin(), values.end());
  return static_cast<int>(std::unique(values.begin(), values.end()) - values.begin());
}

const double* or_null(const std::vector<double>& values) {
  return values.empty() ? nullptr : values.data();
}

}  // namespace

PairResult estimate_pair(const RawPair& raw, const RobustOptions& options) {
  PairResult out;
  Packed packed;
  if (!pack(raw, packed, out)) return out;
  out.num_usable = packed.rows.size();
  RobustOptions scaled = options;
  scaled.seed = raw.seed;
  const double unit = packed.rows.empty() ? 1.0 : normalise(packed);
  if (options.threshold_in_pixels) scaled.threshold = std::min(unit * options.threshold, kWidest);
  const Matches m =
      make_matches(packed.bearings1.data(), packed.bearings2.data(), packed.rows.size(),
                   or_null(packed.weights), or_null(packed.jacobians1), or_null(packed.jacobians2));
  MatchPriors priors;
  priors.scores = std::move(packed.scores);
  if (raw.gravity1 && raw.gravity2) {
    priors.has_gravity = true;
    priors.gravity1 = Eigen::Map<const Eigen::Vector3d>(raw.gravity1);
    priors.gravity2 = Eigen::Map<const Eigen::Vector3d>(raw.gravity2);
  }
  out.robust = estimate_relative_pose(m, scaled, priors);
  RobustResult& found = out.robust;
  out.support = {
      count_distinct(packed, found.inlier),
      std::min(spread_of(packed.bearings1, &found.inlier),
               spread_of(packed.bearings2, &found.inlier)),
      std::min(spread_of(packed.bearings1, nullptr), spread_of(packed.bearings2, nullptr))};
  std::vector<unsigned char> inlier(raw.n, 0);
  std::vector<double> residuals(raw.n, std::nan(""));
  for (std::size_t k = 0; k < packed.rows.size(); ++k) {
    inlier[packed.rows[k]] = found.inlier[k];
    residuals[packed.rows[k]] = found.residuals[k];
  }
  found.inlier = std::move(inlier);
  found.residuals = std::move(residuals);
  return out;
}

std::vector<PairResult> estimate_pairs(const std::vector<RawPair>& pairs,
                                       const RobustOptions& options, int num_threads) {
  std::vector<PairResult> results(pairs.size());
  std::atomic<std::size_t> next{0};
  std::mutex mutex;
  std::exception_ptr failure;
  const auto work = [&] {
    try {
      for (std::size_t i = next++; i < pairs.size(); i = next++) {
        const auto start = Clock::now();
        results[i] = estimate_pair(pairs[i], options);
        results[i].seconds = std::chrono::duration<double>(Clock::now() - start).count();
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
  } catch (const std::system_error&) {  // the system gives no more threads: those at hand do it all
  }
  work();
  for (std::thread& helper : helpers) helper.join();
  if (failure) std::rethrow_exception(failure);
  return results;
}

}  // namespace epi360
