// SPDX-License-Identifier: BSD-3-Clause
#include "core/adjustment/profile_cholesky.h"

#include <cmath>

#include "core/block_sum.h"

namespace epi360 {
namespace {

EPI360_INLINE double product(const double* a, const double* b, std::size_t n) {
  double lanes[kLanes] = {0.0};
  std::size_t k = 0;
  for (; k + kLanes <= n; k += kLanes) {
    for (std::size_t j = 0; j < kLanes; ++j) lanes[j] += a[k + j] * b[k + j];
  }
  double rest = 0.0;
  for (; k < n; ++k) rest += a[k] * b[k];
  return lane_sum(lanes) + rest;
}

}  // namespace

EPI360_MULTIVERSION
bool solve_profile(double* rows, const std::size_t* start, const std::size_t* first, std::size_t n,
                   double* right) {
  for (std::size_t i = 0; i < n; ++i) {
    double* row = rows + start[i];
    for (std::size_t j = first[i]; j <= i; ++j) {
      const double* other = rows + start[j];
      const std::size_t from = first[i] > first[j] ? first[i] : first[j];
      const double rest =
          row[j - first[i]] - product(row + (from - first[i]), other + (from - first[j]), j - from);
      if (j < i) {
        row[j - first[i]] = rest / other[j - first[j]];
      } else {
        if (!(rest > 0.0) || !std::isfinite(rest)) return false;
        row[i - first[i]] = std::sqrt(rest);
      }
    }
    const double known = product(row, right + first[i], i - first[i]);
    right[i] = (right[i] - known) / row[i - first[i]];
  }
  for (std::size_t i = n; i-- > 0;) {
    const double* row = rows + start[i];
    const double x = right[i] / row[i - first[i]];
    right[i] = x;
    for (std::size_t j = first[i]; j < i; ++j) right[j] -= x * row[j - first[i]];
  }
  return true;
}

}  // namespace epi360
