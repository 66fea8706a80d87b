// SPDX-License-Identifier: BSD-3-Clause
#include "core/features/nearest.h"

#include <algorithm>
#include <climits>
#include <cmath>

#include "core/features/products.h"
#include "core/multiversion.h"

namespace epi360 {
namespace {

constexpr float kSteps = 2048.0f;
constexpr std::int32_t kMissing = -2048 * 2048;  // a similarity of -1
constexpr int kTile = 512;                       // targets whose similarities stay in the cache
// A sum of so many products of numbers up to 2048 fits into 32 bits.
constexpr int kLargestSize = 511;

EPI360_MULTIVERSION
void round_row(const float* values, int size, std::int16_t* __restrict out) {
  for (int k = 0; k < size; ++k)
    out[k] = static_cast<std::int16_t>(std::nearbyint(values[k] * kSteps));
}

EPI360_MULTIVERSION
bool is_in_range(const float* values, std::size_t count) {
  bool inside = true;
  for (std::size_t k = 0; k < count; ++k) inside &= std::abs(values[k]) <= 1.0f;
  return inside;
}

EPI360_MULTIVERSION
std::int32_t largest(const std::int32_t* values, int count) {
  std::int32_t most = INT_MIN;
  for (int x = 0; x < count; ++x) most = std::max(most, values[x]);
  return most;
}

EPI360_MULTIVERSION
void raise(const std::int32_t* values, int count, std::int32_t* __restrict most) {
  for (int x = 0; x < count; ++x) most[x] = std::max(most[x], values[x]);
}

// Whole numbers in the order that multiply wants, filled up with rows of zeros.
class Rows {
 public:
  Rows(const Descriptors& all, int together)
      : pairs_((all.size + 1) / 2),
        count_((all.count + together - 1) / together * together),
        values_(static_cast<std::size_t>(count_) * 2 * pairs_) {
    for (int row = 0; row < all.count; ++row) {
      round_row(all.values + static_cast<std::size_t>(row) * all.size, all.size, at(row));
    }
  }

  int pairs() const { return pairs_; }
  int count() const { return count_; }
  std::int16_t* at(int row) { return values_.data() + static_cast<std::size_t>(row) * 2 * pairs_; }

  // kPanel rows from one on, by pairs of components.
  void write_panel(int first, std::int16_t* out) {
    for (int x = 0; x < kPanel; ++x) {
      const std::int16_t* row = at(first + x);
      for (int k = 0; k < pairs_; ++k) {
        out[2 * (kPanel * k + x)] = row[2 * k];
        out[2 * (kPanel * k + x) + 1] = row[2 * k + 1];
      }
    }
  }

 private:
  int pairs_, count_;
  std::vector<std::int16_t> values_;
};

// What is known of a query so far.
struct Query {
  std::int32_t best = INT_MIN, second = kMissing;
  int nearest = -1;

  // Compares it with the targets of a tile, whose similarities may be overwritten. others are those
  // of all targets.
  void see(std::int32_t* similarities, int first, int count, std::int32_t* others) {
    const std::int32_t most = largest(similarities, count);
    if (most > best) {
      const int at =
          static_cast<int>(std::find(similarities, similarities + count, most) - similarities);
      similarities[at] = kMissing;
      if (nearest >= 0) {
        others[nearest] = std::max(others[nearest], best);
        second = std::max(second, best);
      }
      second = std::max(second, largest(similarities, count));
      best = most;
      nearest = first + at;
    } else {
      second = std::max(second, most);
    }
    raise(similarities, count, others + first);
  }
};

float similarity(std::int32_t product) { return static_cast<float>(product) / (kSteps * kSteps); }

}  // namespace

bool can_compare(const Descriptors& queries, const Descriptors& targets) {
  if (!has_products() || queries.size != targets.size || queries.size > kLargestSize) return false;
  for (const Descriptors* each : {&queries, &targets}) {
    if (!is_in_range(each->values, static_cast<std::size_t>(each->count) * each->size))
      return false;
  }
  return true;
}

Nearest two_nearest(const Descriptors& queries, const Descriptors& targets) {
  Rows rows(queries, kGroup), columns(targets, kPanel);
  const int pairs = rows.pairs(), panel_size = 2 * kPanel * pairs;
  std::vector<Query> found(queries.count);
  std::vector<std::int32_t> others(targets.count, kMissing), similarities(kGroup * kTile);
  std::vector<std::int16_t> panels(static_cast<std::size_t>(kTile / kPanel) * panel_size);
  for (int first = 0; first < targets.count; first += kTile) {
    const int count = std::min(kTile, targets.count - first);
    for (int x = 0; x < count; x += kPanel) {
      columns.write_panel(first + x, panels.data() + x / kPanel * panel_size);
    }
    for (int q = 0; q < queries.count; q += kGroup) {
      for (int x = 0; x < count; x += kPanel) {
        multiply(rows.at(q), panels.data() + x / kPanel * panel_size, pairs,
                 similarities.data() + x, kTile);
      }
      for (int k = 0; k < std::min(kGroup, queries.count - q); ++k) {
        found[q + k].see(similarities.data() + k * kTile, first, count, others.data());
      }
    }
  }
  Nearest out;
  for (const Query& query : found) {
    out.nearest.push_back(std::max(query.nearest, 0));
    out.best.push_back(query.nearest < 0 ? -1.0f : similarity(query.best));
    out.second.push_back(similarity(query.second));
  }
  for (const std::int32_t product : others) out.others.push_back(similarity(product));
  return out;
}

}  // namespace epi360
