// SPDX-License-Identifier: BSD-3-Clause
// A small seeded generator: the same numbers on every platform, unlike <random>'s distributions.
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace epi360 {

// SplitMix64 (Steele, Lea & Flood, OOPSLA 2014).
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}

  std::uint64_t next() {
    std::uint64_t z = (state_ += 0x9e3779b97f4a7c15ULL);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return z ^ (z >> 31);
  }

  // Uniform in [0, bound); the bias of at most bound / 2^32 does not matter here.
  std::uint32_t below(std::uint32_t bound) {
    return static_cast<std::uint32_t>(((next() >> 32) * bound) >> 32);
  }

  // Draws `count` distinct indices below `bound`; count is small.
  void distinct(std::uint32_t bound, int count, std::uint32_t* indices) {
    for (int i = 0; i < count; ++i) {
      bool repeated = true;
      while (repeated) {
        indices[i] = below(bound);
        repeated = false;
        for (int j = 0; j < i; ++j) repeated = repeated || indices[j] == indices[i];
      }
    }
  }

  // Puts values from places `begin` and after, chosen at random, into the places up to `end`: the
  // beginning of a Fisher-Yates shuffle.
  void choose(std::vector<std::size_t>& values, std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      std::swap(values[k], values[k + below(static_cast<std::uint32_t>(values.size() - k))]);
    }
  }

 private:
  std::uint64_t state_;
};

}  // namespace epi360
