// SPDX-License-Identifier: BSD-3-Clause
#include "core/features/products.h"

#include <cstring>

#include "core/multiversion.h"

#if defined(__x86_64__) && defined(__GNUC__)
#include <immintrin.h>
#define EPI360_PRODUCTS
#endif

namespace epi360 {

#ifdef EPI360_PRODUCTS
namespace {

// The instruction multiplies two pairs of numbers in each lane and adds both products.
__attribute__((target("avx512bw"))) void multiply_512(const std::int16_t* rows,
                                                      const std::int16_t* panel, int pairs,
                                                      std::int32_t* out, std::ptrdiff_t stride) {
  __m512i left[kGroup], right[kGroup];
  EPI360_UNROLL
  for (int q = 0; q < kGroup; ++q) left[q] = right[q] = _mm512_setzero_si512();
  for (int k = 0; k < pairs; ++k) {
    const __m512i a = _mm512_loadu_si512(panel + 2 * kPanel * k);
    const __m512i b = _mm512_loadu_si512(panel + 2 * kPanel * k + kPanel);
    EPI360_UNROLL
    for (int q = 0; q < kGroup; ++q) {
      std::int32_t pair;
      std::memcpy(&pair, rows + 2 * (static_cast<std::ptrdiff_t>(q) * pairs + k), sizeof pair);
      const __m512i all = _mm512_set1_epi32(pair);
      left[q] = _mm512_add_epi32(left[q], _mm512_madd_epi16(all, a));
      right[q] = _mm512_add_epi32(right[q], _mm512_madd_epi16(all, b));
    }
  }
  EPI360_UNROLL
  for (int q = 0; q < kGroup; ++q) {
    _mm512_storeu_si512(out + q * stride, left[q]);
    _mm512_storeu_si512(out + q * stride + kPanel / 2, right[q]);
  }
}

// A quarter of it: so many sums fit into the registers.
__attribute__((target("avx2"))) void multiply_256(const std::int16_t* rows,
                                                  const std::int16_t* panel, int pairs,
                                                  std::int32_t* out, std::ptrdiff_t stride) {
  constexpr int kRows = kGroup / 2;
  __m256i left[kRows], right[kRows];
  EPI360_UNROLL
  for (int q = 0; q < kRows; ++q) left[q] = right[q] = _mm256_setzero_si256();
  for (int k = 0; k < pairs; ++k) {
    const auto* at = reinterpret_cast<const __m256i*>(panel + 2 * kPanel * k);
    const __m256i a = _mm256_loadu_si256(at), b = _mm256_loadu_si256(at + 1);
    EPI360_UNROLL
    for (int q = 0; q < kRows; ++q) {
      std::int32_t pair;
      std::memcpy(&pair, rows + 2 * (static_cast<std::ptrdiff_t>(q) * pairs + k), sizeof pair);
      const __m256i all = _mm256_set1_epi32(pair);
      left[q] = _mm256_add_epi32(left[q], _mm256_madd_epi16(all, a));
      right[q] = _mm256_add_epi32(right[q], _mm256_madd_epi16(all, b));
    }
  }
  EPI360_UNROLL
  for (int q = 0; q < kRows; ++q) {
    auto* to = reinterpret_cast<__m256i*>(out + q * stride);
    _mm256_storeu_si256(to, left[q]);
    _mm256_storeu_si256(to + 1, right[q]);
  }
}

}  // namespace

bool has_products() { return __builtin_cpu_supports("avx2"); }

void multiply(const std::int16_t* rows, const std::int16_t* panel, int pairs, std::int32_t* out,
              std::ptrdiff_t stride) {
  static const bool is_wide = __builtin_cpu_supports("avx512bw");
  if (is_wide) return multiply_512(rows, panel, pairs, out, stride);
  for (int q = 0; q < kGroup; q += kGroup / 2) {
    for (int x = 0; x < kPanel; x += kPanel / 2) {
      multiply_256(rows + 2 * static_cast<std::ptrdiff_t>(q) * pairs, panel + 2 * x, pairs,
                   out + q * stride + x, stride);
    }
  }
}

#else

bool has_products() { return false; }

void multiply(const std::int16_t*, const std::int16_t*, int, std::int32_t*, std::ptrdiff_t) {}

#endif

}  // namespace epi360
