// SPDX-License-Identifier: BSD-3-Clause
// Real roots of a polynomial by Sturm's theorem.
#pragma once

#include "core/multiversion.h"

namespace epi360 {

EPI360_INLINE double evaluate(const double* coefficients, int degree, double x) {
  double value = coefficients[degree];
  for (int k = degree - 1; k >= 0; --k) value = value * x + coefficients[k];
  return value;
}

// coefficients[k] belongs to x^k, degree <= 10. Writes the distinct real roots, in ascending
// order, and returns their number.
int real_roots(const double* coefficients, int degree, double* roots);

}  // namespace epi360
