// SPDX-License-Identifier: BSD-3-Clause
// Eight floats that compilers keep in registers, which they do not with an array in a loop.
#pragma once

#include <cstring>

#if !defined(__GNUC__)
#include <xmmintrin.h>  // MSVC
#endif

#include "core/multiversion.h"

namespace epi360 {

#if defined(__GNUC__)

using Four = float __attribute__((vector_size(16)));
using Eight = float __attribute__((vector_size(32)));  // slow without registers of this size

template <typename Vector>
EPI360_INLINE void raise(Vector& a, const Vector& b) {
  a = a > b ? a : b;
}
template <typename Vector>
EPI360_INLINE void lower(Vector& a, const Vector& b) {
  a = a < b ? a : b;
}

#else

struct Four {
  __m128 values;
};

EPI360_INLINE Four operator-(float x, const Four& a) {
  return {_mm_sub_ps(_mm_set1_ps(x), a.values)};
}
EPI360_INLINE Four operator*(float x, const Four& a) {
  return {_mm_mul_ps(_mm_set1_ps(x), a.values)};
}
EPI360_INLINE void operator+=(Four& a, const Four& b) { a.values = _mm_add_ps(a.values, b.values); }
EPI360_INLINE void raise(Four& a, const Four& b) { a.values = _mm_max_ps(a.values, b.values); }
EPI360_INLINE void lower(Four& a, const Four& b) { a.values = _mm_min_ps(a.values, b.values); }

#endif

// The same where registers hold four.
struct TwoFours {
  Four low, high;
};

EPI360_INLINE TwoFours operator-(float x, const TwoFours& a) { return {x - a.low, x - a.high}; }
EPI360_INLINE TwoFours operator*(float x, const TwoFours& a) { return {x * a.low, x * a.high}; }
EPI360_INLINE void operator+=(TwoFours& a, const TwoFours& b) {
  a.low += b.low;
  a.high += b.high;
}
EPI360_INLINE void raise(TwoFours& a, const TwoFours& b) {
  raise(a.low, b.low);
  raise(a.high, b.high);
}
EPI360_INLINE void lower(TwoFours& a, const TwoFours& b) {
  lower(a.low, b.low);
  lower(a.high, b.high);
}

template <typename Vector>
EPI360_INLINE void load(const float* from, Vector& out) {
  static_assert(sizeof out == 8 * sizeof(float));
  std::memcpy(&out, from, sizeof out);
}
template <typename Vector>
EPI360_INLINE void store(const Vector& values, float* to) {
  std::memcpy(to, &values, sizeof values);
}

}  // namespace epi360
