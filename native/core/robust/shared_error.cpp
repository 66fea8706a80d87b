// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/shared_error.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "core/bearings.h"
#include "core/constants.h"
#include "core/multiversion.h"
#include "core/robust/covariance.h"
#include "core/robust/derivative_noise.h"
#include "core/vector_exp.h"

namespace epi360 {
namespace {

// Of the correlation, as a chord: it falls to 1 / e.
constexpr double kReachOfShared = 45.0 * kDegree;
// Matches of one cell of view 2, of 15 degrees, are one observation of the field.
constexpr int kBandsOfShared = 12, kSectorsOfShared = 16;
constexpr std::size_t kFewestGroups = 20;  // that the field is estimated from
// Standard deviations; once in sixty by chance, as a few long waves make up most of the sum.
constexpr double kSignificant = 4.0;

// Matches of one cell: sums of their residuals and derivatives over the root of their number n, so
// that independent errors have the variance of one match, and means of bearings and gradients.
struct Groups {
  std::vector<double> column[12];
  std::vector<double> roots;    // of n
  std::vector<double> squares;  // sums of the squares of their residuals
  Eigen::VectorXd residuals;
  Eigen::Matrix<double, Eigen::Dynamic, 5> jacobian;
  Matrix5 information = Matrix5::Zero();  // J^T J of all their matches

  std::size_t size() const { return roots.size(); }
};

struct Group {
  double count = 0.0, residual = 0.0, squares = 0.0;
  Vector5 jacobian = Vector5::Zero();
  Eigen::Vector3d vectors[4] = {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero(),
                                Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
};

// Bands of equal area, cut into equal sectors.
std::size_t group_of(const Eigen::Vector3d& b) {
  const auto part = [](double share, int parts) {
    return std::min(static_cast<int>(share * parts), parts - 1);
  };
  const int band = part(0.5 + 0.5 * std::clamp(b.y(), -1.0, 1.0), kBandsOfShared);
  const int sector = part(0.5 + std::atan2(b.x(), b.z()) / (2.0 * kPi), kSectorsOfShared);
  return static_cast<std::size_t>(band * kSectorsOfShared + sector);
}

// b1, u1, b2, u2 of a match: the bearings and the gradients of its residual by them.
void add_directions(const Matches& m, std::size_t i, const Eigen::Matrix3d& E, Group& group) {
  const Eigen::Vector3d b1 = view1(m, i), b2 = view2(m, i);
  Eigen::Vector3d u1 = E.transpose() * b2, u2 = E * b1;
  const double sine = b2.dot(u2);
  u1 -= sine * b1;
  u2 -= sine * b2;
  const double length = std::sqrt(u1.squaredNorm() + u2.squaredNorm());
  const Eigen::Vector3d vectors[] = {b1, u1 / length, b2, u2 / length};
  for (std::size_t k = 0; k < 4; ++k) group.vectors[k] += vectors[k];
}

Groups grouped(const Matches& m, const RelativePose& pose, const Linearisation& at) {
  std::vector<Group> cells(static_cast<std::size_t>(kBandsOfShared * kSectorsOfShared));
  const Eigen::Matrix3d E = skew(pose.t) * pose.R;
  Groups groups;
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!(at.weights[i] > 0.25 * m.weight[i])) continue;  // none near an epipole
    Group& group = cells[group_of(view2(m, i))];
    const Vector5 J = jacobian_of(at, m.padded, i);
    group.count += 1.0;
    group.residual += at.residuals[i];
    group.squares += at.residuals[i] * at.residuals[i];
    group.jacobian += J;
    groups.information += J * J.transpose();
    add_directions(m, i, E, group);
  }
  cells.erase(std::remove_if(cells.begin(), cells.end(),
                             [](const Group& group) { return group.count == 0.0; }),
              cells.end());
  for (auto& column : groups.column) column.resize(cells.size());
  const auto size = static_cast<Eigen::Index>(cells.size());
  groups.residuals.resize(size);
  groups.jacobian.resize(size, 5);
  for (std::size_t k = 0; k < cells.size(); ++k) {
    const Group& group = cells[k];
    const double root = std::sqrt(group.count);
    groups.roots.push_back(root);
    groups.squares.push_back(group.squares);
    groups.residuals[static_cast<Eigen::Index>(k)] = group.residual / root;
    groups.jacobian.row(static_cast<Eigen::Index>(k)) = group.jacobian.transpose() / root;
    for (std::size_t c = 0; c < 12; ++c) {
      const Eigen::Vector3d& sum = group.vectors[c / 3];
      const double length = c / 3 % 2 == 0 ? sum.norm() : group.count;
      groups.column[c][k] = sum[static_cast<Eigen::Index>(c % 3)] / length;
    }
  }
  return groups;
}

// Row i of the correlations up to its diagonal: of two matches of groups i and j.
EPI360_MULTIVERSION
void correlation_row(const double* const* columns, std::size_t i, double* row) {
  for (std::size_t j = 0; j <= i; ++j) {
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

// The inliers of the cells of view 2: the roots of their numbers, their mean bearings, and how
// these move as the camera turns about each axis, times the root.
struct Cells {
  std::vector<double> root, x, y, z;
  Eigen::Matrix<double, Eigen::Dynamic, 9> turned;

  std::size_t size() const { return root.size(); }
};

Cells cells_of(const Matches& m, const std::vector<unsigned char>& inlier) {
  constexpr auto kCells = static_cast<std::size_t>(kBandsOfShared * kSectorsOfShared);
  std::vector<Eigen::Vector3d> sums(kCells, Eigen::Vector3d::Zero());
  std::vector<double> counts(kCells, 0.0);
  for (std::size_t i = 0; i < m.size; ++i) {
    if (!inlier[i]) continue;
    const Eigen::Vector3d b = view2(m, i);
    const std::size_t cell = group_of(b);
    sums[cell] += b;
    counts[cell] += 1.0;
  }
  Cells cells;
  cells.turned.resize(kCells, 9);
  for (std::size_t k = 0; k < kCells; ++k) {
    if (counts[k] == 0.0) continue;
    const Eigen::Vector3d b = sums[k].normalized();
    const Eigen::Matrix3d turned = std::sqrt(counts[k]) * skew(b);
    cells.turned.row(static_cast<Eigen::Index>(cells.size())) =
        Eigen::Map<const Eigen::Matrix<double, 1, 9>>(turned.data());
    cells.root.push_back(std::sqrt(counts[k]));
    cells.x.push_back(b.x());
    cells.y.push_back(b.y());
    cells.z.push_back(b.z());
  }
  cells.turned.conservativeResize(static_cast<Eigen::Index>(cells.size()), 9);
  return cells;
}

// Row i of what the errors of sums over cells, over the roots of their numbers, have in common but
// for the projections on both tangent planes; returns the sum of the squares with these.
EPI360_MULTIVERSION
double shared_row(const Cells& cells, double shared, std::size_t i, double* row) {
  const double *x = cells.x.data(), *y = cells.y.data(), *z = cells.z.data();
  double squares = 0.0;
  for (std::size_t j = 0; j < cells.size(); ++j) {
    const double cosine = x[i] * x[j] + y[i] * y[j] + z[i] * z[j], chord2 = 2.0 - 2.0 * cosine;
    const double near = vector_exp(-std::sqrt(chord2 > 0.0 ? chord2 : 0.0) / kReachOfShared);
    row[j] = shared * cells.root[i] * cells.root[j] * near + (i == j);
    squares += row[j] * row[j] * (1.0 + cosine * cosine);
  }
  return squares;
}

}  // namespace

SharedError shared_error(const Matches& m, const RelativePose& cam2_from_cam1,
                         const Linearisation& at, double scale, double least) {
  const Groups groups = grouped(m, cam2_from_cam1, at);
  const std::size_t size = groups.size();
  const auto& J = groups.jacobian;
  const Eigen::VectorXd& residuals = groups.residuals;
  const Eigen::Map<const Eigen::VectorXd> roots(groups.roots.data(),
                                                static_cast<Eigen::Index>(size));
  const double* columns[12];
  for (std::size_t c = 0; c < 12; ++c) columns[c] = groups.column[c].data();
  Eigen::VectorXd row(static_cast<Eigen::Index>(size));
  Eigen::Matrix<double, Eigen::Dynamic, 5> KJ =
      Eigen::Matrix<double, Eigen::Dynamic, 5>::Zero(J.rows(), 5);
  double squares = 0.0, observed = 0.0;
  Matrix5 own = Matrix5::Zero();  // of the matches with themselves
  for (std::size_t i = 0; i < size; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    correlation_row(columns, i, row.data());
    auto before = row.head(k);
    before.array() *= roots[k] * roots.head(k).array();
    // Pairs of different matches of one group, too.
    const double count = roots[k] * roots[k], within = (count - 1.0) * row[k];
    squares += 2.0 * before.squaredNorm() + within * within;
    observed += 2.0 * residuals[k] * before.dot(residuals.head(k)) +
                row[k] * (count * residuals[k] * residuals[k] - groups.squares[i]);
    KJ.row(k) += before.transpose() * J.topRows(k) + within * J.row(k);
    KJ.topRows(k) += before * J.row(k);
    own += row[k] * J.row(k).transpose() * J.row(k);
  }
  // The residuals are (I - J H J^T) of the errors. Expectation of r^T K r without a shared error
  // and its derivative by tau^2; K is without its diagonal, a match with itself.
  const double variance = scale * scale;
  const Matrix5 H = bounded_inverse(groups.information / variance) / variance;
  const Matrix5 A = J.transpose() * KJ;
  const double expected = -variance * (H * A).trace();
  const double slope =
      squares - 2.0 * (H * (KJ.transpose() * KJ)).trace() + (A * H * A * H).trace();
  const double excess = observed - expected;
  const bool shows = size >= kFewestGroups && slope > 0.0 &&
                     excess > kSignificant * variance * std::sqrt(2.0 * slope);
  const double tau2 = std::max(shows ? excess / slope : 0.0, least * least * variance);
  return {tau2, tau2 * H * (A + own) * H};
}

double independent_share(const Matches& m, const std::vector<unsigned char>& inlier,
                         double shared) {
  const Cells cells = cells_of(m, inlier);
  const auto size = static_cast<Eigen::Index>(cells.size());
  // An orthonormal basis of what a rotation takes up, three components of three columns a cell.
  Eigen::Matrix3d gram = Eigen::Matrix3d::Zero();
  const auto moved = [&](Eigen::Index k) {
    return Eigen::Map<const Eigen::Matrix3d, 0, Eigen::Stride<Eigen::Dynamic, Eigen::Dynamic>>(
        cells.turned.data() + k, Eigen::Stride<Eigen::Dynamic, Eigen::Dynamic>(3 * size, size));
  };
  for (Eigen::Index k = 0; k < size; ++k) gram += moved(k).transpose() * moved(k);
  const Eigen::Matrix3d to_basis =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(gram).operatorInverseSqrt();
  Eigen::VectorXd row(size);
  double trace = 0.0, squares = 0.0, within = 0.0, crossing = 0.0;
  Eigen::Matrix3d inside = Eigen::Matrix3d::Zero();
  for (Eigen::Index i = 0; i < size; ++i) {
    const auto k = static_cast<std::size_t>(i);
    squares += shared_row(cells, shared, k, row.data());
    trace += 2.0 * row[i];
    within += 2.0 * (cells.root[k] * cells.root[k] - 1.0);
    const Eigen::Matrix<double, 1, 9> sum = row.transpose() * cells.turned;
    const Eigen::Vector3d b(cells.x[k], cells.y[k], cells.z[k]);
    Eigen::Matrix3d across = Eigen::Map<const Eigen::Matrix3d>(sum.data()) * to_basis;
    across -= b * (b.transpose() * across);
    crossing += across.squaredNorm();
    inside += (moved(i) * to_basis).transpose() * across;
  }
  // C without the part that the basis takes up, and what differs from the means of the cells.
  trace += within - inside.trace();
  squares += within - 2.0 * crossing + inside.squaredNorm();
  return trace * trace / (squares * (2.0 * static_cast<double>(size) + within));
}

}  // namespace epi360
