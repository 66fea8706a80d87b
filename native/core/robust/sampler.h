// SPDX-License-Identifier: BSD-3-Clause
// Where minimal samples come from: all matches alike, or the best scored first.
#pragma once

#include <cstdint>

#include "core/robust/random.h"

namespace epi360 {

// Progressive sampling (PROSAC; Chum & Matas, "Matching with PROSAC", CVPR 2005): the t-th sample
// comes from a growing part of the matches, which are in the order of their scores. Without an
// order, from all of them.
class Sampler {
 public:
  Sampler(std::uint32_t num_matches, int sample_size, bool progressive = false)
      : num_(num_matches), size_(sample_size), progressive_(progressive) {
    reached_ = progressive ? static_cast<std::uint32_t>(sample_size) : num_matches;
    // Samples that uniform sampling would draw from the first `size_` matches alone.
    expected_ = kUniformSamples;
    for (int i = 0; i < size_; ++i) expected_ *= static_cast<double>(size_ - i) / (num_ - i);
  }

  void draw(Random& random, std::uint32_t* sample) {
    // Every second sample comes from all matches: scores may mislead.
    uniform_ = !uniform_;
    if (uniform_) {
      random.distinct(num_, size_, sample);
      return;
    }
    ++drawn_;
    while (drawn_ > due_ && reached_ < num_) {
      const double more = expected_ * (reached_ + 1.0) / (reached_ + 1.0 - size_);
      due_ += more - expected_ > 1.0 ? more - expected_ : 1.0;
      expected_ = more;
      ++reached_;
    }
    if (reached_ < num_) {  // the newest match and others before it
      random.distinct(reached_ - 1, size_ - 1, sample);
      sample[size_ - 1] = reached_ - 1;
    } else {
      random.distinct(num_, size_, sample);
    }
  }

  bool progressive() const { return progressive_; }
  // How many matches the samples so far could come from.
  std::uint32_t reached() const { return reached_; }

 private:
  static constexpr double kUniformSamples = 20000.0;  // after so many both draw alike

  std::uint32_t num_, reached_;
  int size_;
  bool progressive_, uniform_ = true;
  double drawn_ = 0.0, due_ = 1.0, expected_ = 0.0;
};

}  // namespace epi360
