// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/grid_noise.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "core/robust/derivative_noise.h"

namespace epi360 {
namespace {

constexpr double kRounding = 2e-7;  // of bearings that were 32-bit numbers, radians
// As many matches, and that share of them, have a coordinate of another one before a grid is
// believed. Of key points that were measured hardly any have.
constexpr double kFewest = 4.0, kFewestInColumns = 2.0;
constexpr double kLeastShare = 0.03;
constexpr double kCentral = 0.9;  // of the coordinates lie in the range that is taken
constexpr int kRounds = 60;
constexpr double kSmallest = 0.02;  // share of the gaps that may be smaller than those of a grid
// ORB finds points in a picture and in seven smaller ones, each 1.2 times smaller, with as many
// times fewer points (Rublee et al. 2011; the numbers of OpenCV and of ORB-SLAM). They share rows
// as often as those of a picture with 4.6 times as many rows; that rows near the horizon have more
// points makes it 3.5 times. The cells of the largest picture are the smallest.
constexpr double kPyramid = 3.5;
constexpr double kLargestCell = 0.06;  // radians: 10 pixels of 1024
// An answer is doubted if its noise is less than this share of that of rounding, and matches that
// are no inliers, and off by two cells at most, are at least so many of its inliers.
constexpr double kLessNoise = 0.7, kNearlyRight = 0.1, kNearCells = 2.0;
constexpr double kOneGrid = 0.3;  // of the distance that rows of one grid have by their number

// The rows of a grid that so many points hit, each row alike, if that many rows are hit: birthdays.
double rows_of_grid(double points, double hit) {
  double low = hit, high = points * points;
  for (int k = 0; k < kRounds; ++k) {
    const double middle = 0.5 * (low + high);
    (middle * -std::expm1(-points / middle) < hit ? low : high) = middle;
  }
  return low;
}

double quantile(const std::vector<double>& sorted, double share) {
  return sorted[static_cast<std::size_t>(share * static_cast<double>(sorted.size() - 1))];
}

// Values of a coordinate, sorted, and the gaps between those that differ.
struct Coordinate {
  std::vector<double> values, gaps;
  explicit Coordinate(std::vector<double> all) : values(std::move(all)) {
    std::sort(values.begin(), values.end());
    for (std::size_t i = 1; i < values.size(); ++i) {
      const double gap = values[i] - values[i - 1];
      if (gap > kRounding) gaps.push_back(gap);
    }
    std::sort(gaps.begin(), gaps.end());
  }
  double size() const { return static_cast<double>(values.size()); }
  double num_rows() const { return static_cast<double>(gaps.size() + 1); }
  double num_shared() const { return size() - num_rows(); }
};

// The distance of a grid's rows, in the unit of the first coordinate; 0 where there is no grid. Of
// one grid it is the smallest gap. Key points of several sizes lie on several, and of these the
// number of rows tells.
double spacing(const Coordinate& rows, const Coordinate& columns) {
  if (rows.gaps.empty() || rows.num_shared() < std::max(kFewest, kLeastShare * rows.size())) {
    return 0.0;
  }
  if (columns.num_shared() < kFewestInColumns) return 0.0;  // as of points and their mirror images
  const double range =
      quantile(rows.values, 0.5 + 0.5 * kCentral) - quantile(rows.values, 0.5 - 0.5 * kCentral);
  const double by_number = range / kCentral / rows_of_grid(rows.size(), rows.num_rows());
  const double by_gaps = quantile(rows.gaps, kSmallest);
  return by_gaps > kOneGrid * by_number ? by_gaps : kPyramid * by_number;
}

// Whether enough values repeat others; most bearings are looked at no further.
bool repeat(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  std::size_t count = 0;
  for (std::size_t i = 1; i < values.size(); ++i) count += values[i] - values[i - 1] <= kRounding;
  return static_cast<double>(count) >= kFewest;
}

struct Bearings {
  const std::vector<double>&x, &y, &z;
  std::size_t size;

  // Each point once: a key point with two directions, or with two partners, is no grid.
  std::vector<std::size_t> distinct() const {
    std::vector<std::size_t> order(size);
    for (std::size_t i = 0; i < size; ++i) order[i] = i;
    const auto before = [&](std::size_t i, std::size_t j) {
      if (y[i] != y[j]) return y[i] < y[j];
      return x[i] != x[j] ? x[i] < x[j] : z[i] < z[j];
    };
    const auto same = [&](std::size_t i, std::size_t j) {
      return x[i] == x[j] && y[i] == y[j] && z[i] == z[j];
    };
    std::sort(order.begin(), order.end(), before);
    order.erase(std::unique(order.begin(), order.end(), same), order.end());
    return order;
  }

  double cell_of_panorama() const {
    if (!repeat({y.begin(), y.begin() + static_cast<std::ptrdiff_t>(size)})) return 0.0;
    std::vector<double> latitudes, longitudes;
    for (const std::size_t i : distinct()) {
      latitudes.push_back(std::asin(std::clamp(y[i], -1.0, 1.0)));
      longitudes.push_back(std::atan2(x[i], z[i]));
    }
    return spacing(Coordinate(std::move(latitudes)), Coordinate(std::move(longitudes)));
  }

  double cell_of_pinhole() const {
    std::vector<double> slopes(size);
    for (std::size_t i = 0; i < size; ++i) {
      if (!(z[i] > 0.0)) return 0.0;
      slopes[i] = y[i] / z[i];
    }
    if (!repeat(std::move(slopes))) return 0.0;
    std::vector<double> rows, columns;
    double squared = 0.0;  // angles over slopes
    for (const std::size_t i : distinct()) {
      rows.push_back(y[i] / z[i]);
      columns.push_back(x[i] / z[i]);
      squared += z[i] * z[i];
    }
    const double mean = squared / static_cast<double>(rows.size());
    return mean * spacing(Coordinate(std::move(rows)), Coordinate(std::move(columns)));
  }

  double cell() const { return std::max(cell_of_panorama(), cell_of_pinhole()); }
};

}  // namespace

double grid_noise(const Matches& m) {
  const double first = Bearings{m.x1, m.y1, m.z1, m.size}.cell();
  if (!(first > 0.0)) return 0.0;
  const double second = Bearings{m.x2, m.y2, m.z2, m.size}.cell();
  const double cell = std::min(first, second);
  return cell < kLargestCell ? cell / std::sqrt(12.0) : 0.0;
}

double least_scale_of_grid(const Matches& m, Residual residual, const RobustResult& answer) {
  const double rounding = grid_noise(m);
  const bool is_rotation = answer.verdict.status == Status::kPureRotation;
  const double per_residual = is_rotation ? 1.0 : noise_per_residual(residual);
  if (!(rounding > 0.0) || !(answer.scale * per_residual < kLessNoise * rounding)) return 0.0;
  const double near = kNearCells * std::sqrt(12.0) * rounding / per_residual;
  double inliers = 0.0, nearly = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (answer.inlier[i]) {
      inliers += m.weight[i];
    } else if (std::abs(answer.residuals[i]) < near) {
      nearly += m.weight[i];
    }
  }
  return nearly > kNearlyRight * inliers ? rounding / noise_per_residual(residual) : 0.0;
}

}  // namespace epi360
