// SPDX-License-Identifier: BSD-3-Clause
#include "matches.h"

namespace epi360 {
namespace {

void fill(std::vector<double>& out, std::size_t padded, const double* rows, std::size_t n,
          std::size_t stride, std::size_t column, double padding) {
  out.assign(padded, padding);
  for (std::size_t i = 0; i < n; ++i) out[i] = rows[stride * i + column];
}

}  // namespace

Matches make_matches(const double* bearings1, const double* bearings2, std::size_t n,
                     const double* weights, const double* jacobians1, const double* jacobians2) {
  Matches m;
  m.size = n;
  m.padded = (n + Matches::kBlock - 1) / Matches::kBlock * Matches::kBlock;
  // The padding match counts nothing; residuals.cpp keeps all denominators above zero.
  fill(m.x1, m.padded, bearings1, n, 3, 0, 1.0);
  fill(m.y1, m.padded, bearings1, n, 3, 1, 0.0);
  fill(m.z1, m.padded, bearings1, n, 3, 2, 0.0);
  fill(m.x2, m.padded, bearings2, n, 3, 0, 0.0);
  fill(m.y2, m.padded, bearings2, n, 3, 1, 1.0);
  fill(m.z2, m.padded, bearings2, n, 3, 2, 0.0);
  m.weight.assign(m.padded, 0.0);
  for (std::size_t i = 0; i < n; ++i) {
    m.weight[i] = weights ? weights[i] : 1.0;
    m.unit_weights = m.unit_weights && m.weight[i] == 1.0;
  }
  if (jacobians1 && jacobians2) {
    std::vector<double>* columns1[6] = {&m.u1x, &m.v1x, &m.u1y, &m.v1y, &m.u1z, &m.v1z};
    std::vector<double>* columns2[6] = {&m.u2x, &m.v2x, &m.u2y, &m.v2y, &m.u2z, &m.v2z};
    for (std::size_t k = 0; k < 6; ++k) {
      fill(*columns1[k], m.padded, jacobians1, n, 6, k, 1.0);
      fill(*columns2[k], m.padded, jacobians2, n, 6, k, 1.0);
    }
  }
  return m;
}

Matches chosen_matches(const Matches& m, const std::vector<std::size_t>& indices) {
  std::vector<double> b1, b2, weights, j1, j2;
  for (const std::size_t i : indices) {
    b1.insert(b1.end(), {m.x1[i], m.y1[i], m.z1[i]});
    b2.insert(b2.end(), {m.x2[i], m.y2[i], m.z2[i]});
    weights.push_back(m.weight[i]);
    if (!m.has_jacobians()) continue;
    j1.insert(j1.end(), {m.u1x[i], m.v1x[i], m.u1y[i], m.v1y[i], m.u1z[i], m.v1z[i]});
    j2.insert(j2.end(), {m.u2x[i], m.v2x[i], m.u2y[i], m.v2y[i], m.u2z[i], m.v2z[i]});
  }
  return make_matches(b1.data(), b2.data(), indices.size(), weights.data(),
                      j1.empty() ? nullptr : j1.data(), j2.empty() ? nullptr : j2.data());
}

}  // namespace epi360
