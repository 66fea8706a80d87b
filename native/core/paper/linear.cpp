// SPDX-License-Identifier: BSD-3-Clause
#include "core/paper/linear.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <stdexcept>

#include "core/solvers/eight_point.h"
#include "core/solvers/gram.h"
#include "core/solvers/svd3.h"

namespace epi360 {
namespace {

using RowMajor3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

Eigen::Matrix3d symmetric(const double* products) {
  Eigen::Matrix3d m;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) m(r, c) = products[kProduct[r][c]];
  }
  return m;
}

// Hartley, "In defense of the eight-point algorithm", 1997, section 6.1, on bearings.
Eigen::Matrix3d isotropic(const ViewMoments& view) {
  const double spread = std::sqrt(view.variance);
  if (!(spread > 1e-12)) {
    throw std::domain_error("isotropic normalization needs two directions, all bearings are equal");
  }
  const double s = std::sqrt(2.0) / spread;
  Eigen::Matrix3d N;
  N << s, 0.0, -s * view.mean[0], 0.0, s, -s * view.mean[1], 0.0, 0.0, 1.0;
  return N;
}

// Section 6.2: L^-1 of the second moments L L^T.
Eigen::Matrix3d non_isotropic(const ViewMoments& view) {
  const Eigen::Matrix3d moments = symmetric(view.second);
  const Eigen::Vector3d spectrum = svd3(moments).lengths;
  if (!(spectrum[2] > 1e-12 * spectrum[0])) {
    throw std::domain_error(
        "non_isotropic normalization needs bearings in three dimensions, these lie in one plane; "
        "use normalization='none'");
  }
  const Eigen::LLT<Eigen::Matrix3d> cholesky(moments);
  return cholesky.matrixL().solve(Eigen::Matrix3d::Identity());
}

Eigen::Matrix3d normalizer(const Matches& m, int view, Normalization kind) {
  const bool white = kind == Normalization::kNonIsotropic ||
                     (kind == Normalization::kIsotropicNonIsotropic && view == 1);
  return white ? non_isotropic(view_moments(m, view)) : isotropic(view_moments(m, view));
}

Eigen::Matrix3d least_algebraic_error(const Matches& m, const LinearSolution& s) {
  if (m.size == 8) return null_as_matrix(m, s.N1, s.N2);
  const RowMajor3 N1 = s.N1, N2 = s.N2;
  return smallest_as_matrix(gram_matrix(gram_sums(m, N1.data(), N2.data())));
}

// Matrix of the form sum w (|P2 E b1|^2 + |P1 E^T b2|^2), P = I - b b^T, in the entries of E.
Gram gradient_matrix(const GramSums& sums, const Gram& M) {
  double moments1[6], moments2[6];  // |b| = 1: a trace over one view leaves the other's moments
  for (int k = 0; k < 6; ++k) {
    moments1[k] = sums.sums[k] + sums.sums[18 + k] + sums.sums[30 + k];
    moments2[k] = sums.sums[6 * k] + sums.sums[6 * k + 3] + sums.sums[6 * k + 5];
  }
  const Eigen::Matrix3d M1 = symmetric(moments1), M2 = symmetric(moments2);
  Gram D = -2.0 * M;
  for (int r = 0; r < 3; ++r) {
    D.block<3, 3>(3 * r, 3 * r) += M1;
    for (int c = 0; c < 3; ++c) D.block<3, 3>(3 * r, 3 * c).diagonal().array() += M2(r, c);
  }
  return D;
}

// Smallest e^T M e / e^T D e (Taubin 1991): with D = L L^T and e = L^-T y the constraint is |y|
// = 1.
Eigen::Matrix3d taubin(const Matches& m) {
  const GramSums sums = gram_sums(m);
  const Gram M = gram_matrix(sums);
  const Eigen::LLT<Gram> cholesky(gradient_matrix(sums, M));
  if (cholesky.info() != Eigen::Success) {
    throw std::domain_error(
        "constraint taubin needs bearings in three dimensions; use constraint='unit'");
  }
  const Eigen::Matrix3d identity = Eigen::Matrix3d::Identity();
  if (m.size == 8) return null_as_matrix(m, identity, identity);
  const Gram half = cholesky.matrixL().solve(M);
  const Gram whole = cholesky.matrixL().solve(half.transpose());
  const RowMajor3 y = smallest_as_matrix(whole);
  Eigen::Matrix<double, 9, 1> e = Eigen::Map<const Eigen::Matrix<double, 9, 1>>(y.data());
  cholesky.matrixU().solveInPlace(e);
  return Eigen::Map<const RowMajor3>(e.data());
}

}  // namespace

LinearSolution solve_linear(const Matches& m, Normalization normalization, Constraint constraint,
                            double S, double K) {
  LinearSolution solution;
  if (constraint == Constraint::kTaubin) {
    solution.E = rank_two(taubin(m));
    return solution;
  }
  if (normalization == Normalization::kNone) {
    const Eigen::Matrix3d identity = Eigen::Matrix3d::Identity();
    solution.E = m.size == 8 ? rank_two(null_as_matrix(m, identity, identity)) : eight_point(m);
    return solution;
  }
  if (normalization == Normalization::kGiven) {
    solution.N1 = solution.N2 = Eigen::Vector3d(S, S, K).asDiagonal();
  } else {
    solution.N1 = normalizer(m, 1, normalization);
    solution.N2 = normalizer(m, 2, normalization);
  }
  const Eigen::Matrix3d normalised = rank_two(least_algebraic_error(m, solution));
  solution.E = scaled(solution.N2.transpose() * normalised * solution.N1);  // eq. 9
  return solution;
}

}  // namespace epi360
