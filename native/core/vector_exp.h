// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "core/multiversion.h"

namespace epi360 {

EPI360_INLINE std::uint64_t bits_of(double x) {
  std::uint64_t b;
  std::memcpy(&b, &x, sizeof b);
  return b;
}

EPI360_INLINE double double_of(std::uint64_t b) {
  double x;
  std::memcpy(&x, &b, sizeof x);
  return x;
}

// The polynomial at x, coefficients from the highest power down.
template <std::size_t n>
EPI360_INLINE double horner(const double (&coefficients)[n], double x) {
  double value = coefficients[0];
  for (std::size_t k = 1; k < n; ++k) value = value * x + coefficients[k];
  return value;
}

// e^x for x in [-600, 0], to 2 units in the last place, in plain arithmetic that compilers turn
// into vectors: 2^k e^r with |r| <= ln 2 / 2 by its Taylor series.
EPI360_INLINE double vector_exp(double x) {
  constexpr double kRound = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds to an integer
  constexpr double kSeries[] = {1.0 / 6227020800.0,
                                1.0 / 479001600.0,
                                1.0 / 39916800.0,
                                1.0 / 3628800.0,
                                1.0 / 362880.0,
                                1.0 / 40320.0,
                                1.0 / 5040.0,
                                1.0 / 720.0,
                                1.0 / 120.0,
                                1.0 / 24.0,
                                1.0 / 6.0,
                                0.5,
                                1.0,
                                1.0};
  x = x < -600.0 ? -600.0 : x;  // products of smaller numbers would be subnormal, and slow
  const double shifted = x * 1.4426950408889634 + kRound;
  const double k = shifted - kRound;
  const double r = (x - k * 0.6931471803691238) - k * 1.9082149292705877e-10;
  const double p = horner(kSeries, r);
  return p * double_of((bits_of(shifted) << 52) + (std::uint64_t{1023} << 52));
}

// Natural logarithm of a positive normal number: e ln 2 + 2 artanh((m - 1) / (m + 1)).
EPI360_INLINE double vector_log(double x) {
  constexpr double kTwo52 = 4503599627370496.0;
  constexpr double kSeries[] = {1.0 / 21.0, 1.0 / 19.0, 1.0 / 17.0, 1.0 / 15.0,
                                1.0 / 13.0, 1.0 / 11.0, 1.0 / 9.0,  1.0 / 7.0,
                                1.0 / 5.0,  1.0 / 3.0,  1.0};
  const std::uint64_t b = bits_of(x);
  double exponent = double_of((b >> 52) | 0x4330000000000000ULL) - kTwo52 - 1023.0;
  double m = double_of((b & 0x000fffffffffffffULL) | 0x3ff0000000000000ULL);
  const bool large = m > 1.4142135623730951;
  m = large ? 0.5 * m : m;
  exponent = large ? exponent + 1.0 : exponent;
  const double f = (m - 1.0) / (m + 1.0);
  return exponent * 0.6931471805599453 + 2.0 * f * horner(kSeries, f * f);
}

}  // namespace epi360
