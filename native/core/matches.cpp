// SPDX-License-Identifier: BSD-3-Clause
#include "matches.h"

namespace epi360 {
namespace {

void fill(std::vector<double>& out, std::size_t padded, const double* rows, std::size_t n,
          std::size_t stride, std::size_t column, double padding) {
  out.assign(padded, padding);
  for (std::size_t i = 0; i < n; ++i) out[i] = rows[stride * i + column];
}

std::size_t padded_size(std::size_t n) {
  return (n + Matches::kBlock - 1) / Matches::kBlock * Matches::kBlock;
}

}  // namespace

Matches make_matches(const double* bearings1, const double* bearings2, std::size_t n,
                     const double* weights, const double* jacobians1, const double* jacobians2) {
  Matches m;
  m.size = n;
  m.padded = padded_size(n);
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

Matches paired_matches(const Matches& m, const std::vector<std::size_t>& rows1,
                       const std::vector<std::size_t>& rows2) {
  Matches out = make_matches(nullptr, nullptr, 0);
  out.size = rows1.size();
  out.padded = padded_size(out.size);
  const auto take = [&](const std::vector<double>& from, const std::vector<std::size_t>& rows,
                        double padding, std::vector<double>& to) {
    if (from.empty()) return;
    to.assign(out.padded, padding);
    for (std::size_t k = 0; k < rows.size(); ++k) to[k] = from[rows[k]];
  };
  take(m.x1, rows1, 1.0, out.x1);
  take(m.y1, rows1, 0.0, out.y1);
  take(m.z1, rows1, 0.0, out.z1);
  take(m.x2, rows2, 0.0, out.x2);
  take(m.y2, rows2, 1.0, out.y2);
  take(m.z2, rows2, 0.0, out.z2);
  take(m.weight, rows1, 0.0, out.weight);
  for (const std::size_t row : rows1) out.unit_weights = out.unit_weights && m.weight[row] == 1.0;
  for (auto column :
       {&Matches::u1x, &Matches::u1y, &Matches::u1z, &Matches::v1x, &Matches::v1y, &Matches::v1z}) {
    take(m.*column, rows1, 1.0, out.*column);
  }
  for (auto column :
       {&Matches::u2x, &Matches::u2y, &Matches::u2z, &Matches::v2x, &Matches::v2y, &Matches::v2z}) {
    take(m.*column, rows2, 1.0, out.*column);
  }
  return out;
}

Matches chosen_matches(const Matches& m, const std::vector<std::size_t>& indices) {
  return paired_matches(m, indices, indices);
}

}  // namespace epi360
