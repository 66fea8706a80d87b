// SPDX-License-Identifier: BSD-3-Clause
#include "core/solvers/polynomial.h"

#include <algorithm>
#include <cmath>

#include "core/multiversion.h"
#include "core/vector_exp.h"

namespace epi360 {
namespace {

constexpr int kMaxDegree = 10, kStack = 64;
constexpr double kInverse[kMaxDegree + 1] = {0.0,     1.0,     1.0 / 2, 1.0 / 3, 1.0 / 4, 1.0 / 5,
                                             1.0 / 6, 1.0 / 7, 1.0 / 8, 1.0 / 9, 1.0 / 10};

EPI360_INLINE void evaluate_with_slope(const double* c, int degree, double x, double* value,
                                       double* slope) {
  double p = c[degree], dp = 0.0;
  for (int k = degree - 1; k >= 0; --k) {
    dp = dp * x + p;
    p = p * x + c[k];
  }
  *value = p;
  *slope = dp;
}

// p, p', and the negated remainders of the Euclidean division, each scaled by a positive number.
class SturmChain {
 public:
  SturmChain(const double* coefficients, int degree) {
    degree_[0] = degree;
    std::copy(coefficients, coefficients + degree + 1, chain_[0]);
    degree_[1] = degree - 1;
    for (int k = 0; k < degree; ++k) chain_[1][k] = (k + 1) * coefficients[k + 1];
    length_ = 2;
    while (degree_[length_ - 1] > 0 && append_remainder()) {
    }
  }

  int sign_changes(double x) const {
    int changes = 0;
    double previous = evaluate(chain_[0], degree_[0], x);
    for (int i = 1; i < length_; ++i) {
      const double value = evaluate(chain_[i], degree_[i], x);
      changes += (previous < 0.0) != (value < 0.0);
      previous = value;
    }
    return changes;
  }

 private:
  // Appends -rem(chain[i], chain[i + 1]); false when it vanishes (a multiple root).
  bool append_remainder() {
    const double* a = chain_[length_ - 2];
    const double* b = chain_[length_ - 1];
    const int da = degree_[length_ - 2], db = degree_[length_ - 1];
    double r[kMaxDegree + 1];
    std::copy(a, a + da + 1, r);
    for (int k = da; k >= db; --k) {
      const double q = r[k] / b[db];
      for (int j = 0; j <= db; ++j) r[k - db + j] -= q * b[j];
    }
    int d = db - 1;
    double largest = 0.0;
    for (int k = 0; k <= d; ++k) largest = std::max(largest, std::abs(r[k]));
    if (!(largest > 0.0) || !std::isfinite(largest)) return false;
    while (d > 0 && std::abs(r[d]) < 1e-14 * largest) --d;
    for (int k = 0; k <= d; ++k) chain_[length_][k] = -r[k] / largest;
    degree_[length_++] = d;
    return true;
  }

  int length_ = 0;
  int degree_[kMaxDegree + 2];
  double chain_[kMaxDegree + 2][kMaxDegree + 1];
};

// Where to cut an interval: roots spread over orders of magnitude.
double cut(double low, double high) {
  if (low < 0.0 && high > 0.0) return -low > 4.0 * high ? -high : high > -4.0 * low ? -low : 0.0;
  if (low > 0.0 && high > 4.0 * low) return std::sqrt(low * high);
  if (high < 0.0 && low < 4.0 * high) return -std::sqrt(low * high);
  return 0.5 * (low + high);
}

// Newton's method kept inside a bracket [low, high] over which the sign changes.
double polish(const double* c, int degree, double low, double high) {
  const bool low_negative = evaluate(c, degree, low) < 0.0;
  double x = cut(low, high);
  for (int iteration = 0; iteration < 60; ++iteration) {
    double value, slope;
    evaluate_with_slope(c, degree, x, &value, &slope);
    if ((value < 0.0) == low_negative) {
      low = x;
    } else {
      high = x;
    }
    double next = x - value / slope;
    if (!(next > low && next < high)) next = cut(low, high);
    const double step = std::abs(next - x);
    x = next;
    if (step <= 1e-13 * (1.0 + std::abs(x))) break;
  }
  return x;
}

struct Bracket {
  double low, high;
  int changes_low, changes_high;
};

// Degree ten without vanishing coefficients, by far the most frequent case: every remainder is one
// degree lower, so p[k] = (slope[k] x + offset[k]) p[k + 1] - drop[k] p[k + 2] and a look at all
// signs costs two products a polynomial. Measured: 0.6 us a polynomial where SturmChain takes 2.2.
struct RegularChain {
  double slope[kMaxDegree], offset[kMaxDegree], drop[kMaxDegree], last;
};

// Fills in the chain from a (degree n) and b (degree n - 1), whose leading coefficients are +-1.
template <int n>
EPI360_INLINE bool extend(const double* a, const double* b, RegularChain& chain) {
  constexpr int k = kMaxDegree - n;
  const double slope = a[n] * b[n - 1];
  chain.slope[k] = slope;
  if constexpr (n == 1) {
    chain.offset[k] = a[0] * b[0];
    chain.drop[k] = 0.0;
    chain.last = b[0];
    return true;
  } else {
    const double offset = (a[n - 1] - slope * b[n - 2]) * b[n - 1];
    double r[n - 1];
    r[0] = a[0] - offset * b[0];
    for (int j = 1; j < n - 1; ++j) r[j] = a[j] - slope * b[j - 1] - offset * b[j];
    const double lead = std::abs(r[n - 2]);
    double largest = 0.0;
    for (int j = 0; j < n - 1; ++j) largest = std::max(largest, std::abs(r[j]));
    if (!(lead > 1e-12 * largest) || !(largest < 1e200)) return false;
    chain.offset[k] = offset;
    chain.drop[k] = lead;
    const double scale = -1.0 / lead;
    for (int j = 0; j < n - 1; ++j) r[j] *= scale;
    return extend<n - 1>(b, r, chain);
  }
}

constexpr int kCuts = 16;

// Sign changes of the chain at each x.
template <int lanes>
EPI360_INLINE void count_changes(const RegularChain& c, const double* x, int* changes) {
  double after[lanes], value[lanes], count[lanes];
  for (int j = 0; j < lanes; ++j) {
    after[j] = 0.0;
    value[j] = c.last;
    count[j] = 0.0;
  }
  for (int k = kMaxDegree - 1; k >= 0; --k) {
    for (int j = 0; j < lanes; ++j) {
      const double before = (c.slope[k] * x[j] + c.offset[k]) * value[j] - c.drop[k] * after[j];
      count[j] += before * value[j] < 0.0 ? 1.0 : 0.0;
      after[j] = value[j];
      value[j] = before;
    }
  }
  for (int j = 0; j < lanes; ++j) changes[j] = static_cast<int>(count[j]);
}

// Pushes the parts of a bracket, cut at x, over which the chain changes.
EPI360_INLINE void split(const Bracket& b, const double* x, const int* changes, Bracket* stack,
                         int& depth) {
  double from = b.low;
  int above = b.changes_low;
  for (int j = 0; j <= kCuts; ++j) {
    const double to = j < kCuts ? x[j] : b.high;
    const int below = j < kCuts ? changes[j] : b.changes_high;
    if (above > below && depth < kStack) stack[depth++] = {from, to, above, below};
    from = to;
    above = below;
  }
}

constexpr int kTogether = 4;

// Newton's method kept inside brackets over which the sign changes, four roots at a time.
EPI360_INLINE void polish_four(const double* c, double* low, double* high, double* x) {
  double sign[kTogether], step[kTogether];
  for (int j = 0; j < kTogether; ++j) {
    sign[j] = evaluate(c, kMaxDegree, low[j]) < 0.0 ? -1.0 : 1.0;
  }
  for (int iteration = 0; iteration < 60; ++iteration) {
    for (int j = 0; j < kTogether; ++j) {
      double p, slope;
      evaluate_with_slope(c, kMaxDegree, x[j], &p, &slope);
      const bool beyond = p * sign[j] > 0.0;  // the sign of the lower end: the root lies above
      low[j] = beyond ? x[j] : low[j];
      high[j] = beyond ? high[j] : x[j];
      const double newton = x[j] - p / slope, middle = 0.5 * (low[j] + high[j]);
      // Quadratic convergence: after so short a step the root is there to the last digits.
      step[j] = std::abs(newton - x[j]) - 1e-9 * (1.0 + std::abs(newton));
      x[j] = (newton > low[j] && newton < high[j]) || step[j] <= 0.0 ? newton : middle;
    }
    double largest = step[0];
    for (int j = 1; j < kTogether; ++j) largest = std::max(largest, step[j]);
    if (largest <= 0.0) break;
  }
}

// Cuts of the real line: roots spread over orders of magnitude.
constexpr double kGrid[kCuts - 1] = {-64.0, -16.0, -6.0, -2.5, -1.2, -0.6, -0.25, 0.0,
                                     0.25,  0.6,   1.2,  2.5,  6.0,  16.0, 64.0};
constexpr double kOutermost = kGrid[kCuts - 2];  // a bracket beyond it may span orders of magnitude

// Roots of a monic polynomial of degree ten; -1 where the chain is not regular.
EPI360_INLINE int regular_roots(const double* c, double bound, double* roots) {
  double slope[kMaxDegree];
  for (int k = 0; k < kMaxDegree; ++k) slope[k] = (k + 1) * c[k + 1] / kMaxDegree;
  RegularChain chain;
  if (!extend<kMaxDegree>(c, slope, chain)) return -1;

  double x[kCuts];
  int changes[kCuts], num_cuts = 0, depth = 0, found = 0;
  for (const double at : kGrid) {
    if (std::abs(at) < bound) x[num_cuts++] = at;
  }
  std::fill(x + num_cuts, x + kCuts, bound);
  count_changes<kCuts>(chain, x, changes);
  Bracket stack[kStack], whole{-bound, bound, 0, changes[kCuts - 1]};
  count_changes<1>(chain, &whole.low, &whole.changes_low);
  split(whole, x, changes, stack, depth);
  double low[kMaxDegree + kTogether], high[kMaxDegree + kTogether];
  while (depth > 0 && found < kMaxDegree) {
    const Bracket b = stack[--depth];
    const int count = b.changes_low - b.changes_high;
    if (count <= 0) continue;
    const bool narrow = b.high - b.low < 1e-12 * (1.0 + std::abs(b.low));
    if (count == 1 || narrow || depth > 40) {
      low[found] = b.low;
      high[found++] = b.high;
      continue;
    }
    for (int j = 0; j < kCuts; ++j) x[j] = b.low + (b.high - b.low) * (j + 1) / (kCuts + 1);
    count_changes<kCuts>(chain, x, changes);
    split(b, x, changes, stack, depth);
  }
  if (found == 0) return 0;
  for (int j = found; j < found + kTogether; ++j) {  // lanes that nobody reads
    low[j] = low[0];
    high[j] = high[0];
  }
  for (int start = 0; start < found; start += kTogether) {
    double start_at[kTogether];
    for (int j = 0; j < kTogether; ++j) {
      const double a = low[start + j], b = high[start + j];
      start_at[j] = std::max(b, -a) > kOutermost ? cut(a, b) : 0.5 * (a + b);
    }
    polish_four(c, low + start, high + start, start_at);
    for (int j = 0; j < kTogether && start + j < found; ++j) roots[start + j] = start_at[j];
  }
  std::sort(roots, roots + found);
  return found;
}

}  // namespace

EPI360_MULTIVERSION
int real_roots(const double* coefficients, int degree, double* roots) {
  double largest = 0.0;
  for (int k = 0; k <= degree; ++k) largest = std::max(largest, std::abs(coefficients[k]));
  if (!(largest > 0.0) || !std::isfinite(largest)) return 0;
  while (degree > 0 && std::abs(coefficients[degree]) < 1e-14 * largest) --degree;
  if (degree == 0) return 0;
  double c[kMaxDegree + 1];
  for (int k = 0; k <= degree; ++k) c[k] = coefficients[k] / coefficients[degree];

  // Fujiwara's bound on the modulus of the roots,
  // with powers of two instead of the roots of the coefficients: ten calls of pow cost more
  // than all the rest.
  double exponent = -1000.0;
  for (int k = 0; k < degree; ++k) {
    const double above =
        static_cast<double>((bits_of(c[k]) >> 52) & 0x7ff) - 1022.0;  // |c[k]| < 2^above
    exponent = std::max(exponent, above * kInverse[degree - k]);
  }
  const double bound = std::ldexp(2.0, static_cast<int>(std::ceil(exponent)));

  if (degree == kMaxDegree) {
    const int count = regular_roots(c, bound, roots);
    if (count >= 0) return count;
  }
  const SturmChain chain(c, degree);
  Bracket stack[kStack];
  int depth = 0, found = 0;
  stack[depth++] = {-bound, bound, chain.sign_changes(-bound), chain.sign_changes(bound)};
  while (depth > 0 && found < degree) {
    const Bracket i = stack[--depth];
    const int count = i.changes_low - i.changes_high;
    if (count <= 0) continue;
    const double middle = cut(i.low, i.high);
    const bool narrow = i.high - i.low < 1e-12 * (1.0 + std::abs(middle));
    if (count == 1 || narrow || depth > 60) {
      roots[found++] = narrow ? middle : polish(c, degree, i.low, i.high);
      continue;
    }
    const int changes = chain.sign_changes(middle);
    stack[depth++] = {middle, i.high, changes, i.changes_high};  // popped last: ascending order
    stack[depth++] = {i.low, middle, i.changes_low, changes};
  }
  return found;
}

}  // namespace epi360
