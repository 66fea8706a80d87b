// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/evidence.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/bearings.h"
#include "core/constants.h"
#include "core/refinement/refine.h"
#include "core/robust/random.h"

namespace epi360 {
namespace {

constexpr double kTan60 = 1.7320508075688772;
// Density of distances from a line in a flat disc of radius 1: 1 / (pi d) at the distance d from a
// point through which the line goes in any direction, where 1 / d of two points has the mean
// 16 / (3 pi). Residuals share a distance between two views, which makes them denser by a root of
// two, and some wrong matches lie behind a camera: the two about cancel.
constexpr double kDensityInDisc = 16.0 / (3.0 * kPi * kPi);
constexpr double kNarrowestView = 1.0 * kDegree;  // all matches may have one bearing
constexpr std::size_t kChancePairs = 1536;

int cell_index(double x, double y, double z) {
  const int band = std::min(kBands - 1, static_cast<int>(0.5 * (y + 1.0) * kBands));
  // Three sectors a quadrant, told apart by the slope: an arctangent would cost ten times as much.
  // Nothing branches, because nobody could predict where the next bearing lies.
  const int right = x >= 0.0, ahead = z >= 0.0;
  const double ax = std::abs(x), az = std::abs(z);
  const int steep = az * kTan60 < ax, flat = ax * kTan60 < az;
  const int third = 1 + (right == ahead ? steep - flat : flat - steep);
  const int quadrant = right ? 1 - ahead : 2 + ahead;
  return band * kSectors + 3 * quadrant + third;
}

// Natural logarithm of n!, by Stirling's series: lgamma of the library writes a global variable.
double log_factorial(int n) {
  double product = 1.0, x = n + 1.0;
  for (; x < 16.0; x += 1.0) product *= x;
  const double y = 1.0 / (x * x);
  const double series = (1.0 / 12.0 - y * (1.0 / 360.0 - y * (1.0 / 1260.0 - y / 1680.0))) / x;
  return (x - 0.5) * std::log(x) - x + 0.5 * std::log(2.0 * kPi) + series - std::log(product);
}

double log10_choose(int n, int k) {
  return (log_factorial(n) - log_factorial(k) - log_factorial(n - k)) / std::log(10.0);
}

// Sums of bearings, and the cells that hold one.
struct Gathered {
  double sum[3] = {0.0, 0.0, 0.0}, count = 0.0;
  std::array<bool, kNumCells> cells{};

  void add(double x, double y, double z, std::size_t cell) {
    sum[0] += x;
    sum[1] += y;
    sum[2] += z;
    count += 1.0;
    cells[cell] = true;
  }
  Extent extent() const {
    if (count == 0.0) return {};
    const auto occupied = std::count(cells.begin(), cells.end(), true);
    const double length = std::sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]);
    return {static_cast<double>(occupied) / kNumCells, 1.0 - length / count};
  }
};

}  // namespace

ChanceDensity::ChanceDensity(const Matches& m, Residual residual, std::uint64_t seed)
    : residual_(residual) {
  Random random(seed ^ 0x5bf03635f0a5b5d7ULL);
  const auto n = static_cast<std::uint32_t>(m.size);
  std::vector<std::size_t> rows1(kChancePairs), rows2(kChancePairs);
  for (std::size_t k = 0; k < kChancePairs; ++k) {
    const std::uint32_t i = random.below(n);
    std::uint32_t j = random.below(n);
    if (j == i) j = (j + 1) % n;
    rows1[k] = i;
    rows2[k] = j;
  }
  shuffled_ = paired_matches(m, rows1, rows2);
  residuals_.resize(shuffled_.padded);
  margins_.resize(shuffled_.padded);
}

double ChanceDensity::at(const RelativePose& pose, double range) const {
  compute_residuals(shuffled_, residual_, plain(pose), residuals_.data(), margins_.data());
  const double tolerance = std::min(range, kLargestWrongParallax);
  double count = 1.0;  // never zero
  for (std::size_t i = 0; i < shuffled_.size; ++i) {
    count += margins_[i] > -tolerance && std::abs(residuals_[i]) < range;
  }
  return count / (static_cast<double>(shuffled_.size) * 2.0 * range);
}

double ChanceDensity::rotation_share(const Eigen::Matrix3d& R, double gate) const {
  const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rows = R;
  compute_rotation_residuals(shuffled_, rows.data(), residuals_.data());
  double count = 1.0;
  for (std::size_t i = 0; i < shuffled_.size; ++i) count += residuals_[i] < gate;
  return count / static_cast<double>(shuffled_.size + 1);
}

double density_in_view(const Matches& m) {
  double length = 1.0;  // of the mean bearing: (1 + cos r) / 2 for a disc of radius r
  for (const auto view : {view1, view2}) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    double weights = 0.0;
    for (std::size_t i = 0; i < m.size; ++i) {
      sum += m.weight[i] * view(m, i);
      weights += m.weight[i];
    }
    if (weights > 0.0) length = std::min(length, sum.norm() / weights);
  }
  const double radius = std::acos(std::min(std::max(2.0 * length - 1.0, -1.0), 1.0));
  return std::max(kTypicalDensity, kDensityInDisc / std::max(radius, kNarrowestView));
}

double log10_false_alarms(int matches, int inliers, double probability, int sample_size) {
  if (inliers <= sample_size) return std::log10(10.0 * std::max(matches - sample_size, 1));
  const double p = std::min(std::max(probability, 1e-12), 1.0);
  return std::log10(10.0 * std::max(matches - sample_size, 1)) + log10_choose(matches, inliers) +
         log10_choose(inliers, sample_size) + (inliers - sample_size) * std::log10(p);
}

std::size_t cell_of(const Eigen::Vector3d& b) {
  return static_cast<std::size_t>(cell_index(b.x(), b.y(), b.z()));
}

Extents extents(const Matches& m, const unsigned char* chosen) {
  Extents lower;
  for (int view = 1; view <= 2; ++view) {
    const double* x = view == 1 ? m.x1.data() : m.x2.data();
    const double* y = view == 1 ? m.y1.data() : m.y2.data();
    const double* z = view == 1 ? m.z1.data() : m.z2.data();
    Gathered all, some;
    for (std::size_t i = 0; i < m.size; ++i) {
      const auto cell = static_cast<std::size_t>(cell_index(x[i], y[i], z[i]));
      all.add(x[i], y[i], z[i], cell);
      if (chosen[i]) some.add(x[i], y[i], z[i], cell);
    }
    const auto take = [&](const Extent& extent, Extent& least) {
      least.coverage = view == 1 ? extent.coverage : std::min(least.coverage, extent.coverage);
      least.spread = view == 1 ? extent.spread : std::min(least.spread, extent.spread);
    };
    take(all.extent(), lower.all);
    take(some.extent(), lower.chosen);
  }
  return lower;
}

double median_parallax(const Matches& m, const RelativePose& pose, const unsigned char* chosen) {
  std::vector<double> squares;  // of chords, which order as the angles do
  squares.reserve(m.size);
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!chosen[i]) continue;
    const Eigen::Vector3d a = pose.R * view1(m, i);
    squares.push_back((a - view2(m, i)).squaredNorm());
  }
  if (squares.empty()) return std::nan("");
  const auto middle = squares.begin() + static_cast<std::ptrdiff_t>(squares.size() / 2);
  std::nth_element(squares.begin(), middle, squares.end());
  return 2.0 * std::asin(std::min(0.5 * std::sqrt(*middle), 1.0));
}

}  // namespace epi360
