// SPDX-License-Identifier: BSD-3-Clause
#include "polynomial.h"

#include <algorithm>
#include <cmath>

namespace epi360 {
namespace {

constexpr int kMaxDegree = 10;

double evaluate(const double* c, int degree, double x) {
  double value = c[degree];
  for (int k = degree - 1; k >= 0; --k) value = value * x + c[k];
  return value;
}

void evaluate_with_slope(const double* c, int degree, double x, double* value, double* slope) {
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

// Newton's method kept inside a bracket [low, high] over which the sign changes.
double polish(const double* c, int degree, double low, double high) {
  const bool low_negative = evaluate(c, degree, low) < 0.0;
  double x = 0.5 * (low + high);
  for (int iteration = 0; iteration < 60; ++iteration) {
    double value, slope;
    evaluate_with_slope(c, degree, x, &value, &slope);
    if ((value < 0.0) == low_negative) {
      low = x;
    } else {
      high = x;
    }
    double next = x - value / slope;
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    const double step = std::abs(next - x);
    x = next;
    if (step <= 1e-14 * (1.0 + std::abs(x))) break;
  }
  return x;
}

struct Interval {
  double low, high;
  int changes_low, changes_high;
};

}  // namespace

int real_roots(const double* coefficients, int degree, double* roots) {
  double largest = 0.0;
  for (int k = 0; k <= degree; ++k) largest = std::max(largest, std::abs(coefficients[k]));
  if (!(largest > 0.0) || !std::isfinite(largest)) return 0;
  while (degree > 0 && std::abs(coefficients[degree]) < 1e-14 * largest) --degree;
  if (degree == 0) return 0;
  double c[kMaxDegree + 1];
  for (int k = 0; k <= degree; ++k) c[k] = coefficients[k] / coefficients[degree];

  // Fujiwara's bound on the modulus of the roots.
  double bound = 0.0;
  for (int k = 0; k < degree; ++k) {
    bound = std::max(bound, std::pow(std::abs(c[k]), 1.0 / (degree - k)));
  }
  bound = 2.0 * bound + 1e-9;

  const SturmChain chain(c, degree);
  Interval stack[64];
  int depth = 0, found = 0;
  stack[depth++] = {-bound, bound, chain.sign_changes(-bound), chain.sign_changes(bound)};
  while (depth > 0 && found < degree) {
    const Interval i = stack[--depth];
    const int count = i.changes_low - i.changes_high;
    if (count <= 0) continue;
    const double middle = 0.5 * (i.low + i.high);
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
