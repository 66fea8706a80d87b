// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/neighbourhoods.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <numeric>
#include <utility>

#include "core/constants.h"

namespace epi360 {
namespace {

using Index = std::uint32_t;
using Indices = std::vector<Index>;

constexpr std::size_t kLargestGroup = 5;   // matches that all exchange partners
constexpr double kRegion = 3.0 * kDegree;  // matches nearer in both views are one region

// Numbers of [-1, 1] in their order; equal ones stay in the order of their places. Sixteen bits by
// two counting passes, the rest by insertion: comparisons that nobody can predict take five times
// as long.
Indices order_of(const std::vector<double>& values, std::size_t n) {
  std::vector<std::uint16_t> keys(n);
  std::array<Index, 256> low{}, high{};
  for (std::size_t i = 0; i < n; ++i) {
    keys[i] = static_cast<std::uint16_t>((values[i] + 1.0) * 32767.0);
    ++low[keys[i] & 255];
    ++high[keys[i] >> 8];
  }
  for (auto* counts : {&low, &high}) {
    Index before = 0;
    for (Index& count : *counts) before += std::exchange(count, before);
  }
  Indices by_low(n), order(n);
  for (std::size_t i = 0; i < n; ++i) by_low[low[keys[i] & 255]++] = static_cast<Index>(i);
  for (const Index i : by_low) order[high[keys[i] >> 8]++] = i;
  for (std::size_t k = 1; k < n; ++k) {
    const Index i = order[k];
    std::size_t place = k;
    for (; place > 0 && values[i] < values[order[place - 1]]; --place)
      order[place] = order[place - 1];
    order[place] = i;
  }
  return order;
}

// Halves the longest side of a set of points until a few are left, or that side is short. Each axis
// keeps all points in its order, so that the sides and the middle of a set are known.
class Halving {
 public:
  Halving(const std::vector<double>& x, const std::vector<double>& y, const std::vector<double>& z,
          std::size_t n, double shortest)
      : shortest_(shortest),
        axes_{&x, &y, &z},
        order_{order_of(x, n), order_of(y, n), order_of(z, n)},
        second_(n),
        spare_(n) {
    halve(0, n);
  }

  const Indices& members() const { return order_[0]; }
  const std::vector<std::size_t>& ends() const { return ends_; }

 private:
  void halve(std::size_t begin, std::size_t end) {
    if (end - begin <= kLargestGroup) {
      ends_.push_back(end);
      return;
    }
    const auto side = [&](std::size_t axis) {
      const Indices& order = order_[axis];
      return (*axes_[axis])[order[end - 1]] - (*axes_[axis])[order[begin]];
    };
    std::size_t longest = 0;
    for (std::size_t axis = 1; axis < 3; ++axis) {
      if (side(axis) > side(longest)) longest = axis;
    }
    if (side(longest) < shortest_) {
      ends_.push_back(end);
      return;
    }
    const std::size_t middle = begin + (end - begin) / 2;
    for (std::size_t k = begin; k < end; ++k) second_[order_[longest][k]] = k >= middle;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      if (axis != longest) part(order_[axis], begin, middle, end);
    }
    halve(begin, middle);
    halve(middle, end);
  }

  // Moves the points of the second half behind the others, in the order that they have.
  void part(Indices& order, std::size_t begin, std::size_t middle, std::size_t end) {
    std::size_t first = begin, second = 0;
    for (std::size_t k = begin; k < end; ++k) {  // without a branch
      const Index i = order[k];
      order[first] = i;
      spare_[second] = i;
      first += !second_[i];
      second += second_[i];
    }
    std::copy_n(spare_.begin(), second, order.begin() + static_cast<std::ptrdiff_t>(middle));
  }

  double shortest_;
  std::array<const std::vector<double>*, 3> axes_;
  std::array<Indices, 3> order_;
  std::vector<unsigned char> second_;
  Indices spare_;
  std::vector<std::size_t> ends_;
};

}  // namespace

Exchange exchanged_partners(const Matches& m, int view, double reach) {
  const double shortest = 2.0 * std::sin(0.5 * std::min(reach, kPi));
  const Halving groups = view == 1 ? Halving(m.x1, m.y1, m.z1, m.size, shortest)
                                   : Halving(m.x2, m.y2, m.z2, m.size, shortest);
  Exchange out;
  out.own.reserve((kLargestGroup - 1) * m.size);
  out.other.reserve((kLargestGroup - 1) * m.size);
  std::size_t begin = 0;
  for (const std::size_t end : groups.ends()) {
    const std::size_t size = end - begin, num_others = std::min(size, kLargestGroup);
    for (std::size_t a = 0; a < size; ++a) {
      for (std::size_t k = 1; k < num_others; ++k) {
        out.own.push_back(groups.members()[begin + a]);
        out.other.push_back(groups.members()[begin + (a + k * size / num_others) % size]);
      }
    }
    begin = end;
  }
  return out;
}

std::vector<double> region_weights(const Matches& m) {
  const double chord = 2.0 * std::sin(0.5 * kRegion), squared = chord * chord;
  const Indices order = order_of(m.y1, m.size);
  const Matches s = chosen_matches(m, {order.begin(), order.end()});
  std::vector<double> near(s.weight.begin(),
                           s.weight.begin() + static_cast<std::ptrdiff_t>(m.size));
  const auto apart = [&](const std::vector<double>& x, const std::vector<double>& y,
                         const std::vector<double>& z, std::size_t a, std::size_t b) {
    const double dx = x[a] - x[b], dy = y[a] - y[b], dz = z[a] - z[b];
    return dx * dx + dy * dy + dz * dz > squared;
  };
  for (std::size_t a = 0; a < m.size; ++a) {  // sorted by y
    for (std::size_t b = a + 1; b < m.size && s.y1[b] - s.y1[a] < chord; ++b) {
      if (apart(s.x1, s.y1, s.z1, a, b) || apart(s.x2, s.y2, s.z2, a, b)) continue;
      near[a] += s.weight[b];
      near[b] += s.weight[a];
    }
  }
  std::vector<double> votes(m.size);
  for (std::size_t a = 0; a < m.size; ++a) {
    votes[order[a]] = s.weight[a] / std::max(near[a], 1.0);
  }
  return votes;
}

std::vector<std::size_t> one_of_each_region(const Matches& m) {
  const double chord = 2.0 * std::sin(0.5 * kRegion), squared = chord * chord;
  std::vector<std::size_t> heaviest(m.size), chosen;
  std::iota(heaviest.begin(), heaviest.end(), std::size_t{0});
  std::stable_sort(heaviest.begin(), heaviest.end(),
                   [&](std::size_t a, std::size_t b) { return m.weight[a] > m.weight[b]; });
  std::multimap<double, std::size_t> by_height;  // of those that are chosen
  for (const std::size_t i : heaviest) {
    if (!(m.weight[i] > 0.0)) break;
    const auto end = by_height.upper_bound(m.y1[i] + chord);
    const bool is_known =
        std::any_of(by_height.lower_bound(m.y1[i] - chord), end,
                    [&](const std::pair<double, std::size_t>& one) {
                      const std::size_t j = one.second;
                      return (view1(m, i) - view1(m, j)).squaredNorm() <= squared &&
                             (view2(m, i) - view2(m, j)).squaredNorm() <= squared;
                    });
    if (is_known) continue;
    by_height.emplace(m.y1[i], i);
    chosen.push_back(i);
  }
  std::sort(chosen.begin(), chosen.end());
  return chosen;
}

}  // namespace epi360
