// SPDX-License-Identifier: BSD-3-Clause
// EPI360_MULTIVERSION compiles a function once more for AVX2 + FMA processors and picks at load
// time, where the compiler and the platform can; elsewhere it is empty and the code is the same.
// EPI360_MULTIVERSION_WIDE does so for AVX-512, too: for loops over rows of pictures or over
// matches, which gain a tenth to a fifth by it; solvers of single samples lose a tenth.
// EPI360_CLONES says whether there are such copies. Both are only for files without Eigen, which
// chooses its vector code by preprocessor.
#pragma once

#include <climits>  // declares __GLIBC__ where there is one

#if defined(__x86_64__) && defined(__linux__) && defined(__GLIBC__) && defined(__GNUC__) && \
    !defined(__clang__) && __GNUC__ >= 12
#define EPI360_CLONES
#define EPI360_MULTIVERSION __attribute__((target_clones("arch=x86-64-v3", "default")))
#define EPI360_MULTIVERSION_WIDE \
  __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define EPI360_MULTIVERSION
#define EPI360_MULTIVERSION_WIDE
#endif

#if defined(_MSC_VER)
#define EPI360_INLINE static __forceinline
#define EPI360_INLINE_LAMBDA  // [&](...) EPI360_INLINE_LAMBDA { ... }
#else
#define EPI360_INLINE static inline __attribute__((always_inline))
#define EPI360_INLINE_LAMBDA __attribute__((always_inline))
#endif

// Before a loop whose number of turns is a constant: unrolls it early, so that the arrays that it
// indexes stay in registers.
#if defined(__GNUC__) && !defined(__clang__)
#define EPI360_UNROLL _Pragma("GCC unroll 16")
#else
#define EPI360_UNROLL
#endif
