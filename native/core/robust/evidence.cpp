// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/evidence.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/bearings.h"
#include "core/refinement/refine.h"
#include "core/robust/random.h"

namespace epi360 {
namespace {

constexpr double kTan60 = 1.7320508075688772;
constexpr std::size_t kChancePairs = 768;

int cell_index(double x, double y, double z) {
  const int band = std::min(kBands - 1, static_cast<int>(0.5 * (y + 1.0) * kBands));
  // Three sectors a quadrant, told apart by the slope: an arctangent would cost ten times as much.
  const bool right = x >= 0.0, ahead = z >= 0.0;
  const double along = right == ahead ? std::abs(x) : std::abs(z);
  const double across = right == ahead ? std::abs(z) : std::abs(x);
  const int third = along * kTan60 < across ? 0 : across * kTan60 < along ? 2 : 1;
  const int quadrant = ahead ? (right ? 0 : 3) : (right ? 1 : 2);
  return band * kSectors + 3 * quadrant + third;
}

double log10_choose(int n, int k) {
  return (std::lgamma(n + 1.0) - std::lgamma(k + 1.0) - std::lgamma(n - k + 1.0)) / std::log(10.0);
}

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
  in_front_.resize(shuffled_.padded);
}

double ChanceDensity::at(const RelativePose& pose, double range) const {
  compute_residuals(shuffled_, residual_, plain(pose), std::min(range, kLargestWrongParallax),
                    residuals_.data(), in_front_.data());
  double count = 1.0;  // never zero
  for (std::size_t i = 0; i < shuffled_.size; ++i) {
    count += in_front_[i] > 0.5 && std::abs(residuals_[i]) < range;
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

double log10_false_alarms(int matches, int inliers, double probability, int sample_size) {
  if (inliers <= sample_size) return std::log10(10.0 * std::max(matches - sample_size, 1));
  const double p = std::min(std::max(probability, 1e-12), 1.0);
  return std::log10(10.0 * std::max(matches - sample_size, 1)) + log10_choose(matches, inliers) +
         log10_choose(inliers, sample_size) + (inliers - sample_size) * std::log10(p);
}

std::size_t cell_of(const Eigen::Vector3d& b) {
  return static_cast<std::size_t>(cell_index(b.x(), b.y(), b.z()));
}

double sphere_coverage(const Matches& m, const unsigned char* chosen) {
  std::array<bool, kBands * kSectors> cells1{}, cells2{};
  for (std::size_t i = 0; i < m.size; ++i) {
    if (chosen && !chosen[i]) continue;
    cells1[static_cast<std::size_t>(cell_index(m.x1[i], m.y1[i], m.z1[i]))] = true;
    cells2[static_cast<std::size_t>(cell_index(m.x2[i], m.y2[i], m.z2[i]))] = true;
  }
  const auto occupied = std::min(std::count(cells1.begin(), cells1.end(), true),
                                 std::count(cells2.begin(), cells2.end(), true));
  return static_cast<double>(occupied) / (kBands * kSectors);
}

double mean_spread(const Matches& m, const unsigned char* chosen) {
  double sums1[3] = {0.0, 0.0, 0.0}, sums2[3] = {0.0, 0.0, 0.0}, count = 0.0;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (chosen && !chosen[i]) continue;
    sums1[0] += m.x1[i];
    sums1[1] += m.y1[i];
    sums1[2] += m.z1[i];
    sums2[0] += m.x2[i];
    sums2[1] += m.y2[i];
    sums2[2] += m.z2[i];
    count += 1.0;
  }
  if (count == 0.0) return 0.0;
  const auto spread = [&](const double* sum) {
    return 1.0 - std::sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]) / count;
  };
  return std::min(spread(sums1), spread(sums2));
}

int count_distinct(const Matches& m, const unsigned char* chosen) {
  std::vector<double> values;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!chosen[i]) continue;
    // One projection tells them apart.
    double value = 0.0;
    value += m.x1[i] * 0.6180 + m.x2[i] * 1.3247;
    value += m.y1[i] * 0.7549 + m.y2[i] * 1.2207;
    value += m.z1[i] * 0.8192 + m.z2[i] * 1.1673;
    values.push_back(std::round(value * 1e12));
  }
  std::sort(values.begin(), values.end());
  return static_cast<int>(std::unique(values.begin(), values.end()) - values.begin());
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
