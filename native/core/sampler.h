// SPDX-License-Identifier: BSD-3-Clause
// Where minimal samples come from: all matches alike, or the best scored first.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "random.h"

namespace epi360 {

// Progressive sampling (PROSAC; Chum & Matas, "Matching with PROSAC", CVPR 2005): the t-th sample
// comes from a growing part of the matches in the order of their scores. Without an order, from
// all of them.
class Sampler {
 public:
  Sampler(std::uint32_t num_matches, int sample_size) : num_(num_matches), size_(sample_size) {
    reached_ = num_matches;
  }
  // order: all matches, best first.
  Sampler(std::vector<std::uint32_t> order, int sample_size)
      : order_(std::move(order)),
        num_(static_cast<std::uint32_t>(order_.size())),
        size_(sample_size),
        reached_(static_cast<std::uint32_t>(sample_size)) {
    // Samples that uniform sampling would draw from the first `size_` matches alone.
    expected_ = kUniformSamples;
    for (int i = 0; i < size_; ++i) expected_ *= static_cast<double>(size_ - i) / (num_ - i);
    due_ = 1.0;
  }

  void draw(Random& random, std::uint32_t* sample) {
    if (order_.empty()) {
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
    for (int i = 0; i < size_; ++i) sample[i] = order_[sample[i]];
  }

  // How many matches the samples so far could come from, and their order (empty: as they are).
  std::uint32_t reached() const { return reached_; }
  const std::vector<std::uint32_t>& order() const { return order_; }

 private:
  static constexpr double kUniformSamples = 20000.0;  // after so many both draw alike

  std::vector<std::uint32_t> order_;
  std::uint32_t num_ = 0;
  int size_ = 5;
  std::uint32_t reached_ = 0;
  double drawn_ = 0.0, due_ = 0.0, expected_ = 0.0;
};

}  // namespace epi360
