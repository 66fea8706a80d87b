// SPDX-License-Identifier: BSD-3-Clause
#include "core/matches.h"

namespace epi360 {
namespace {

std::size_t padded_size(std::size_t n) {
  return (n + Matches::kBlock - 1) / Matches::kBlock * Matches::kBlock;
}

}  // namespace

std::array<std::vector<double>*, 6> jacobian_columns(Matches& m, int view) {
  if (view == 1) return {&m.u1x, &m.v1x, &m.u1y, &m.v1y, &m.u1z, &m.v1z};
  return {&m.u2x, &m.v2x, &m.u2y, &m.v2y, &m.u2z, &m.v2z};
}

// All arrays, with the value that each has in the padding match.
template <typename Visit>
void for_each_array(Matches& m, bool with_jacobians, const Visit& visit) {
  for (auto array : {&Matches::x1, &Matches::y2}) visit(m.*array, 1.0);
  for (auto array : {&Matches::y1, &Matches::z1, &Matches::x2, &Matches::z2, &Matches::weight}) {
    visit(m.*array, 0.0);
  }
  for (int view = 1; with_jacobians && view <= 2; ++view) {
    for (std::vector<double>* column : jacobian_columns(m, view)) visit(*column, 1.0);
  }
}

Matches padding_matches(std::size_t n, bool with_jacobians) {
  Matches m;
  m.size = n;
  m.padded = padded_size(n);
  // The padding match counts nothing; residuals.cpp keeps all denominators above zero.
  const auto fill = [&](std::vector<double>& array, double value) {
    array.assign(m.padded, value);
  };
  for_each_array(m, with_jacobians, fill);
  return m;
}

void truncate(Matches& m, std::size_t n) {
  m.size = n;
  m.padded = padded_size(n);
  for_each_array(m, m.has_jacobians(),
                 [&](std::vector<double>& array, double) { array.resize(m.padded); });
}

void set_bearings(Matches& m, std::size_t i, const double* bearing1, const double* bearing2) {
  m.x1[i] = bearing1[0];
  m.y1[i] = bearing1[1];
  m.z1[i] = bearing1[2];
  m.x2[i] = bearing2[0];
  m.y2[i] = bearing2[1];
  m.z2[i] = bearing2[2];
}

void set_jacobians(Matches& m, std::size_t i, const double* jacobian1, const double* jacobian2) {
  const auto columns1 = jacobian_columns(m, 1), columns2 = jacobian_columns(m, 2);
  for (std::size_t k = 0; k < 6; ++k) {
    (*columns1[k])[i] = jacobian1[k];
    (*columns2[k])[i] = jacobian2[k];
  }
}

Matches make_matches(const double* bearings1, const double* bearings2, std::size_t n,
                     const double* weights, const double* jacobians1, const double* jacobians2) {
  const bool has_jacobians = jacobians1 && jacobians2;
  Matches m = padding_matches(n, has_jacobians);
  for (std::size_t i = 0; i < n; ++i) {
    set_bearings(m, i, bearings1 + 3 * i, bearings2 + 3 * i);
    if (has_jacobians) set_jacobians(m, i, jacobians1 + 6 * i, jacobians2 + 6 * i);
    m.weight[i] = weights ? weights[i] : 1.0;
    m.unit_weights = m.unit_weights && m.weight[i] == 1.0;
  }
  return m;
}

Matches paired_matches(const Matches& m, const std::vector<std::size_t>& rows1,
                       const std::vector<std::size_t>& rows2) {
  Matches out = padding_matches(rows1.size(), m.has_jacobians());
  const auto take = [](const std::vector<double>& from, const std::vector<std::size_t>& rows,
                       std::vector<double>& to) {
    for (std::size_t k = 0; k < rows.size() && !from.empty(); ++k) to[k] = from[rows[k]];
  };
  for (auto column : {&Matches::x1, &Matches::y1, &Matches::z1, &Matches::weight, &Matches::u1x,
                      &Matches::u1y, &Matches::u1z, &Matches::v1x, &Matches::v1y, &Matches::v1z}) {
    take(m.*column, rows1, out.*column);
  }
  for (auto column : {&Matches::x2, &Matches::y2, &Matches::z2, &Matches::u2x, &Matches::u2y,
                      &Matches::u2z, &Matches::v2x, &Matches::v2y, &Matches::v2z}) {
    take(m.*column, rows2, out.*column);
  }
  out.least_scale = m.least_scale;
  for (const std::size_t row : rows1) out.unit_weights = out.unit_weights && m.weight[row] == 1.0;
  return out;
}

Matches chosen_matches(const Matches& m, const std::vector<std::size_t>& indices) {
  return paired_matches(m, indices, indices);
}

}  // namespace epi360
