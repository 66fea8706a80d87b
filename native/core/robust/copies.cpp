// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/copies.h"

#include <array>
#include <cmath>
#include <cstdint>

#include "core/robust/random.h"

namespace epi360 {
namespace {

constexpr double kDigits = 1e12;

// A set of matches by their bearings: a hash table with open addressing.
class DistinctMatches {
 public:
  explicit DistinctMatches(const Matches& m) : m_(m), keys_(m.size) {
    std::size_t size = 1;
    while (size <= 2 * m.size) size *= 2;
    table_.assign(size, kFree);
  }

  // Adds match i, unless there is one like it; returns the one that is there.
  std::size_t add(std::size_t i) {
    std::uint64_t hash = 0;
    std::size_t at = 0;
    for (const auto* column : {&m_.x1, &m_.y1, &m_.z1, &m_.x2, &m_.y2, &m_.z2}) {
      keys_[i][at] = static_cast<std::int64_t>(std::nearbyint(kDigits * (*column)[i]));
      hash = Random(hash ^ static_cast<std::uint64_t>(keys_[i][at++])).next();
    }
    const std::size_t last = table_.size() - 1;
    std::size_t place = static_cast<std::size_t>(hash) & last;
    for (; table_[place] != kFree; place = (place + 1) & last) {
      if (keys_[table_[place]] == keys_[i]) return table_[place];
    }
    return table_[place] = i;
  }

 private:
  static constexpr std::size_t kFree = static_cast<std::size_t>(-1);

  const Matches& m_;
  std::vector<std::array<std::int64_t, 6>> keys_;
  std::vector<std::size_t> table_;
};

}  // namespace

std::vector<std::size_t> first_of_copies(const Matches& m) {
  DistinctMatches distinct(m);
  std::vector<std::size_t> first(m.size);
  for (std::size_t i = 0; i < m.size; ++i) first[i] = distinct.add(i);
  return first;
}

int count_distinct(const Matches& m, const unsigned char* chosen, int enough) {
  DistinctMatches distinct(m);
  int count = 0;
  for (std::size_t i = 0; i < m.size && count < enough; ++i) {
    count += chosen[i] && distinct.add(i) == i;
  }
  return count;
}

}  // namespace epi360
