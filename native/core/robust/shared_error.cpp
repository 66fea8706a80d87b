// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/shared_error.h"

#include <algorithm>
#include <cmath>

#include "core/constants.h"
#include "core/multiversion.h"
#include "core/robust/covariance.h"
#include "core/vector_exp.h"

namespace epi360 {
namespace {

constexpr double kReachOfShared =
    45.0 * kDegree;                      // of the correlation, as a chord: it falls to 1 / e
constexpr std::size_t kMostAsked = 192;  // matches; the work grows with the square
constexpr std::size_t kFewestAsked = 20;
// Standard deviations; once in sixty by chance, as a few long waves make up most of the sum.
constexpr double kSignificant = 4.0;

// Columns of the matches that are asked: bearings and gradients of both views.
struct Asked {
  std::vector<double> column[12];
  std::vector<double> residuals;
  double share = 0.0;  // of the matches that count
  Eigen::Matrix<double, Eigen::Dynamic, 5> jacobian;

  std::size_t size() const { return residuals.size(); }
};

// Evenly spread over the order of the matches, which is no order in space.
Asked matches_to_ask(const Matches& m, const RelativePose& pose, const Linearisation& at) {
  std::vector<std::size_t> inliers;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (at.weights[i] > 0.25 * m.weight[i]) inliers.push_back(i);  // none near an epipole
  }
  const std::size_t size = std::min(inliers.size(), kMostAsked);
  Asked asked;
  for (auto& column : asked.column) column.resize(size);
  asked.residuals.resize(size);
  asked.jacobian.resize(static_cast<Eigen::Index>(size), 5);
  asked.share = static_cast<double>(size) / static_cast<double>(inliers.size());
  const Eigen::Matrix3d E = skew(pose.t) * pose.R;
  for (std::size_t k = 0; k < size; ++k) {
    const std::size_t i = inliers[k * inliers.size() / size];
    const Eigen::Vector3d b1 = view1(m, i), b2 = view2(m, i);
    Eigen::Vector3d u1 = E.transpose() * b2, u2 = E * b1;
    const double sine = b2.dot(u2);
    u1 -= sine * b1;
    u2 -= sine * b2;
    const double length = std::sqrt(u1.squaredNorm() + u2.squaredNorm());
    const Eigen::Vector3d vectors[] = {b1, u1 / length, b2, u2 / length};
    for (std::size_t c = 0; c < 12; ++c) {
      asked.column[c][k] = vectors[c / 3][static_cast<Eigen::Index>(c % 3)];
    }
    asked.residuals[k] = at.residuals[i];
    asked.jacobian.row(static_cast<Eigen::Index>(k)) = jacobian_of(at, m.padded, i).transpose();
  }
  return asked;
}

// Row i of K up to its diagonal.
EPI360_MULTIVERSION
void correlation_row(const double* const* columns, std::size_t i, double* row) {
  for (std::size_t j = 0; j < i; ++j) {
    double sum = 0.0;
    for (std::size_t view = 0; view < 2; ++view) {
      const double* const* c = columns + 6 * view;
      const double near = c[0][i] * c[0][j] + c[1][i] * c[1][j] + c[2][i] * c[2][j];
      const double along = c[3][i] * c[3][j] + c[4][i] * c[4][j] + c[5][i] * c[5][j];
      const double chord2 = 2.0 - 2.0 * near;
      sum += along * vector_exp(-std::sqrt(chord2 > 0.0 ? chord2 : 0.0) / kReachOfShared);
    }
    row[j] = sum;
  }
}

}  // namespace

Matrix5 shared_error_covariance(const Matches& m, const RelativePose& cam2_from_cam1,
                                const Linearisation& at, double scale, double least) {
  const Asked asked = matches_to_ask(m, cam2_from_cam1, at);
  const std::size_t size = asked.size();
  if (size < kFewestAsked) return Matrix5::Zero();
  const auto& J = asked.jacobian;
  const Eigen::Map<const Eigen::VectorXd> residuals(asked.residuals.data(),
                                                    static_cast<Eigen::Index>(size));
  const double* columns[12];
  for (std::size_t c = 0; c < 12; ++c) columns[c] = asked.column[c].data();
  Eigen::VectorXd row(static_cast<Eigen::Index>(size));
  Eigen::Matrix<double, Eigen::Dynamic, 5> KJ =
      Eigen::Matrix<double, Eigen::Dynamic, 5>::Zero(J.rows(), 5);
  double squares = 0.0, observed = 0.0;
  for (std::size_t i = 1; i < size; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    correlation_row(columns, i, row.data());
    const auto before = row.head(k);
    squares += 2.0 * before.squaredNorm();
    observed += 2.0 * residuals[k] * before.dot(residuals.head(k));
    KJ.row(k) += before.transpose() * J.topRows(k);
    KJ.topRows(k) += before * J.row(k);
  }
  // The residuals are (I - J H J^T) of the errors, with H of all matches where they are independent
  // and of those asked where they are shared. Expectation of r^T K r without a shared error and its
  // derivative by tau^2; K is without its diagonal.
  const Matrix5 H = bounded_inverse(J.transpose() * J / (scale * scale)) / (scale * scale);
  const Matrix5 A = J.transpose() * KJ;
  const double variance = scale * scale, expected = -variance * asked.share * (H * A).trace();
  const double slope =
      squares - 2.0 * (H * (KJ.transpose() * KJ)).trace() + (A * H * A * H).trace();
  if (!(slope > 0.0)) return Matrix5::Zero();
  const double excess = observed - expected;
  const bool shows = excess > kSignificant * variance * std::sqrt(2.0 * slope);
  const double tau2 = std::max(shows ? excess / slope : 0.0, least * least * variance);
  return tau2 * H * (A + J.transpose() * J) * H;
}

}  // namespace epi360
