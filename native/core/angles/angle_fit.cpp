// SPDX-License-Identifier: BSD-3-Clause
#include "core/angles/angle_fit.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

namespace epi360 {
namespace {

constexpr double kLargestChange = 0.35;
constexpr double kReach = 3.0;  // of the last loss, in noise
// Steps, those of them whose loss is wider, and how much wider the first one is.
struct Schedule {
  int num_steps, annealed;
  double widest;
};
constexpr Schedule kOfPose{9, 6, 4.0}, kOfTurn{14, 10, 40.0};
constexpr double kSmallestNorm = 1e-12;
constexpr double kNegligible = 1e-15;  // eigenvalues, of the largest one

constexpr int kMostUnknowns = 5 + 2 * kMostChanges;
using Unknowns = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMostUnknowns, 1>;
using Information =
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMostUnknowns, kMostUnknowns>;

// Sums of weighted squares, and the Gauss-Newton step that they say; what they do not determine
// stays as it is.
class NormalEquations {
 public:
  explicit NormalEquations(int unknowns)
      : information_(Information::Zero(unknowns, unknowns)), pull_(Unknowns::Zero(unknowns)) {}

  void add(double weight, const Unknowns& row, double residual) {
    information_.noalias() += (weight * row) * row.transpose();
    pull_ += (weight * residual) * row;
  }

  Unknowns step() const {
    const Eigen::SelfAdjointEigenSolver<Information> solver(information_);
    const Unknowns& values = solver.eigenvalues();
    const double least = kNegligible * values.cwiseAbs().maxCoeff();
    Unknowns along = -(solver.eigenvectors().transpose() * pull_);
    for (int k = 0; k < along.size(); ++k) {
      along[k] = std::abs(values[k]) > least ? along[k] / values[k] : 0.0;
    }
    return solver.eigenvectors() * along;
  }

 private:
  Information information_;
  Unknowns pull_;
};

void change(Changes& changes, const Unknowns& step, int first) {
  for (int k = 0; k < changes.size(); ++k) {
    changes[k] = std::clamp(changes[k] + step[first + k], -kLargestChange, kLargestChange);
  }
}

// Tangent Sampson error of a match in the angles as they were measured, so that smaller angles do
// not make smaller residuals, with its derivatives.
struct Linearised {
  double residual;
  Unknowns row;
  Eigen::Vector3d gradient1, gradient2, bearing1, bearing2;
};

class PoseFit {
 public:
  PoseFit(const PairAngles& angles, const RelativePose& start, const Changes& start_changes)
      : angles_(angles), pose_(start), changes_(start_changes) {}

  const RelativePose& pose() const { return pose_; }
  const Changes& changes() const { return changes_; }
  std::size_t size() const { return angles_.first.size(); }
  int num_unknowns() const { return 5 + static_cast<int>(changes_.size()); }

  // What the matches say of the pose and the changes as they are.
  template <typename Use>
  void linearise(const Use& use) const {
    const Eigen::Matrix3d E = skew(pose_.t) * pose_.R;
    const Eigen::Matrix<double, 3, 2> tangents = tangent_basis(pose_.t);
    const int second = angles_.second_begins();
    Linearised at;
    for (std::size_t i = 0; i < size(); ++i) {
      const ChangedBearing seen1 = angles_.first.changed(i, changes_.data());
      const ChangedBearing seen2 = angles_.second.changed(i, changes_.data() + second);
      const Eigen::Vector3d &b1 = seen1.bearing, &b2 = seen2.bearing;
      const Eigen::Vector3d turned = pose_.R * b1;
      const Eigen::Vector3d normal1 = E.transpose() * b2, normal2 = E * b1;
      const double squared = (seen1.by_measured.transpose() * normal1).squaredNorm() +
                             (seen2.by_measured.transpose() * normal2).squaredNorm();
      const double scale = 1.0 / std::max(std::sqrt(squared), kSmallestNorm);
      at.residual = scale * b2.dot(normal2);
      at.row.setZero(num_unknowns());
      at.row.head<3>() = turned.dot(pose_.t) * b2 - turned.dot(b2) * pose_.t;
      for (int k = 0; k < 2; ++k) at.row[3 + k] = tangents.col(k).cross(turned).dot(b2);
      for (int k = 0; k < angles_.first.num_changes(); ++k) {
        at.row[5 + k] += seen1.by_changes.col(k).dot(normal1);
      }
      for (int k = 0; k < angles_.second.num_changes(); ++k) {
        at.row[5 + second + k] += seen2.by_changes.col(k).dot(normal2);
      }
      at.row *= scale;
      at.gradient1 = scale * (normal1 - normal1.dot(b1) * b1);
      at.gradient2 = scale * (normal2 - normal2.dot(b2) * b2);
      at.bearing1 = b1;
      at.bearing2 = b2;
      use(at);
    }
  }

  void step(double reach) {
    NormalEquations equations(num_unknowns());
    linearise([&](const Linearised& at) {
      const double ratio = 1.0 + at.residual * at.residual / (reach * reach);
      equations.add(1.0 / (ratio * ratio), at.row, at.residual);
    });
    const Unknowns move = equations.step();
    pose_.R = exp_so3(move.head<3>()) * pose_.R;
    pose_.t = (pose_.t + tangent_basis(pose_.t) * move.segment<2>(3)).normalized();
    change(changes_, move, 5);
  }

 private:
  const PairAngles& angles_;
  RelativePose pose_;
  Changes changes_;
};

// Geman-McClure loss of a residual, in units of the noise.
double loss_of(double residual, double noise) {
  const double square = std::pow(residual / (kReach * noise), 2);
  return 0.5 * kReach * kReach * square / (1.0 + square);
}

void append(std::vector<double>& values, const Eigen::Vector3d& vector) {
  values.insert(values.end(), vector.data(), vector.data() + 3);
}

double median_of(std::vector<double> values) {
  const auto middle = values.begin() + values.size() / 2;
  std::nth_element(values.begin(), middle, values.end());
  if (values.size() % 2 == 1) return *middle;
  return 0.5 * (*middle + *std::max_element(values.begin(), middle));
}

}  // namespace

AngleFit fit_angle_changes(const PairAngles& angles, const RelativePose& start,
                           const Changes& start_changes, double noise) {
  PoseFit fit(angles, start, start_changes);
  std::vector<double> before;
  fit.linearise([&](const Linearised& at) { before.push_back(at.residual); });
  for (int step = 0; step < kOfPose.num_steps; ++step) {
    const double narrowed = (kOfPose.widest - 1.0) * step / kOfPose.annealed;
    fit.step(kReach * noise * std::max(1.0, kOfPose.widest - narrowed));
  }
  AngleFit found;
  found.gain = 0.0;
  fit.linearise([&](const Linearised& at) {
    const double earlier = before[found.residuals.size()];
    if (std::abs(earlier) < kReach * noise) {
      found.gain += loss_of(earlier, noise) - loss_of(at.residual, noise);
    }
    found.residuals.push_back(at.residual);
    found.jacobian.insert(found.jacobian.end(), at.row.data(), at.row.data() + at.row.size());
    append(found.gradients1, at.gradient1);
    append(found.gradients2, at.gradient2);
    append(found.bearings1, at.bearing1);
    append(found.bearings2, at.bearing2);
  });
  found.cam2_from_cam1 = fit.pose();
  found.changes = fit.changes();
  return found;
}

std::optional<Changes> changed_by_a_turn(const PairAngles& angles, const Eigen::Matrix3d& rotation,
                                         double noise) {
  const std::size_t count = angles.first.size();
  const int second = angles.second_begins(), unknowns = 3 + angles.num_changes();
  Eigen::Matrix3d R = rotation;
  Changes changes = Changes::Zero(angles.num_changes());
  std::vector<double> squares(count);
  double reach = 0.0;
  for (int step = 0; step < kOfTurn.num_steps; ++step) {
    const double left = 1.0 - static_cast<double>(step) / kOfTurn.annealed;
    reach = kReach * noise * std::max(1.0, std::pow(kOfTurn.widest, left));
    NormalEquations equations(unknowns);
    for (std::size_t i = 0; i < count; ++i) {
      const ChangedBearing seen1 = angles.first.changed(i, changes.data());
      const ChangedBearing seen2 = angles.second.changed(i, changes.data() + second);
      const Eigen::Vector3d turned = R * seen1.bearing, apart = turned - seen2.bearing;
      squares[i] = apart.squaredNorm();
      const double ratio = 1.0 + 0.5 * squares[i] / (reach * reach);
      const Eigen::Matrix<double, 3, kMostChanges> moved = R * seen1.by_changes;
      const Eigen::Matrix3d by_turn = -skew(turned);
      for (int axis = 0; axis < 3; ++axis) {
        Unknowns row = Unknowns::Zero(unknowns);
        row.head<3>() = by_turn.row(axis).transpose();
        for (int k = 0; k < angles.first.num_changes(); ++k) row[3 + k] += moved(axis, k);
        for (int k = 0; k < angles.second.num_changes(); ++k) {
          row[3 + second + k] -= seen2.by_changes(axis, k);
        }
        equations.add(1.0 / (ratio * ratio), row, apart[axis]);
      }
    }
    const Unknowns move = equations.step();
    R = exp_so3(move.head<3>()) * R;
    change(changes, move, 3);
  }
  const bool fits = median_of(squares) < 2.0 * reach * reach;
  const bool is_small = changes.cwiseAbs().maxCoeff() < kLargestChange;
  return fits && is_small ? std::optional<Changes>(changes) : std::nullopt;
}

}  // namespace epi360
