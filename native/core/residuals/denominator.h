// SPDX-License-Identifier: BSD-3-Clause
// What the loops over residuals divide by.
#pragma once

#include "core/multiversion.h"

namespace epi360 {

// Least squared denominator: at an epipole residual and Jacobian stay finite, and their product
// with a weight of zero is zero.
constexpr double kLeastDenominator = 1e-20;

EPI360_INLINE double at_least(double squared) {
  return squared > kLeastDenominator ? squared : kLeastDenominator;
}

}  // namespace epi360
