// SPDX-License-Identifier: BSD-3-Clause
// One bearing of a match as a vector; the hot loops read the arrays themselves.
#pragma once

#include <Eigen/Core>

#include "core/matches.h"

namespace epi360 {

inline Eigen::Vector3d view1(const Matches& m, std::size_t i) {
  return {m.x1[i], m.y1[i], m.z1[i]};
}
inline Eigen::Vector3d view2(const Matches& m, std::size_t i) {
  return {m.x2[i], m.y2[i], m.z2[i]};
}

}  // namespace epi360
