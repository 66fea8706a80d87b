// SPDX-License-Identifier: BSD-3-Clause
// Real roots of a polynomial by Sturm's theorem.
#pragma once

namespace epi360 {

// coefficients[k] belongs to x^k, degree <= 10. Writes the distinct real roots, in ascending
// order, and returns their number.
int real_roots(const double* coefficients, int degree, double* roots);

}  // namespace epi360
