// SPDX-License-Identifier: BSD-3-Clause
#include "bindings/arrays.h"
#include "core/surfaces/growth.h"

using namespace nanobind::literals;

namespace epi360 {
namespace {

using GreyLevels = nb::ndarray<const unsigned char, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using FloatRow = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Vectors = nb::ndarray<const float, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using CellNumbers = nb::ndarray<const std::int32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using CellRows = nb::ndarray<const std::int32_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

GreyPanorama panorama(const GreyLevels& levels) {
  if (levels.shape(0) != GreyPanorama::kLevels || levels.shape(1) < 2 || levels.shape(2) < 2) {
    throw nb::value_error("a panorama has four levels of grey values");
  }
  return {levels.data(), static_cast<int>(levels.shape(2)), static_cast<int>(levels.shape(1))};
}

nb::object float_rows(std::vector<float> values, std::size_t columns = 0) {
  auto* owned = new std::vector<float>(std::move(values));
  nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<float>*>(p); });
  const std::size_t shape[2] = {owned->size() / (columns > 0 ? columns : 1), columns};
  return nb::ndarray<nb::numpy, float>(owned->data(), columns > 0 ? 2 : 1, shape, owner).cast();
}

void check_cells(const std::int32_t* cells, std::size_t count, std::size_t num_cells) {
  for (std::size_t k = 0; k < count; ++k) {
    if (cells[k] < 0 || static_cast<std::size_t>(cells[k]) >= num_cells) {
      throw nb::value_error("there is no such cell");
    }
  }
}

void check_rows(const CellRows& rows, std::size_t count, std::size_t columns) {
  if (rows.shape(0) != count || rows.shape(1) != columns) {
    throw nb::value_error("every cell needs 8 neighbours and 24 cells around it");
  }
  check_cells(rows.data(), count * columns, count);
}

}  // namespace

void bind_surfaces(nb::module_& m) {
  m.def(
      "grow_surfaces",
      [](const GreyLevels& first, const GreyLevels& second, const Matrix3& rotation,
         const Vector3& translation, const Vectors& directions, const CellRows& neighbours,
         const CellRows& around, const CellNumbers& seed_cells, const FloatRow& seed_depths) {
        const std::size_t count = directions.shape(0);
        check_rows(neighbours, count, SphereGrid::kNeighbours);
        check_rows(around, count, SphereGrid::kAround);
        check_cells(seed_cells.data(), seed_cells.shape(0), count);
        if (seed_depths.shape(0) != seed_cells.shape(0)) {
          throw nb::value_error("every seed needs a depth");
        }
        const PanoramaPair pair = make_panorama_pair(panorama(first), panorama(second),
                                                     rotation.data(), translation.data());
        const SphereGrid grid{count, directions.data(), neighbours.data(), around.data()};
        const Seeds seeds{seed_cells.shape(0), seed_cells.data(), seed_depths.data()};
        SharedSurfaces found = unlocked([&] { return grow_surfaces(pair, grid, seeds); });
        return nb::make_tuple(
            float_rows(std::move(found.contrast)), float_rows(std::move(found.depth)),
            float_rows(std::move(found.likeness)), float_rows(std::move(found.normal), 3),
            float_rows(std::move(found.expected_depth)),
            float_rows(std::move(found.expected_likeness)));
      },
      "first"_a, "second"_a, "rotation"_a, "translation"_a, "directions"_a, "neighbours"_a,
      "around"_a, "seed_cells"_a, "seed_depths"_a);

  m.def(
      "surface_likeness",
      [](const GreyLevels& first, const GreyLevels& second, const Matrix3& rotation,
         const Vector3& translation, const Vectors& directions, const FloatRow& depths,
         const Vectors& normals) {
        const std::size_t count = directions.shape(0);
        if (depths.shape(0) != count || normals.shape(0) != count) {
          throw nb::value_error("every direction needs a depth and a normal");
        }
        const PanoramaPair pair = make_panorama_pair(panorama(first), panorama(second),
                                                     rotation.data(), translation.data());
        std::vector<float> likeness(count);
        unlocked([&] {
          const auto vector = [](const float* v) { return Vec3f{v[0], v[1], v[2]}; };
          for (std::size_t i = 0; i < count; ++i) {
            const Patch patch = patch_at(pair, vector(directions.data() + 3 * i));
            const Vec3f normal = vector(normals.data() + 3 * i);
            likeness[i] = look_for_either(pair, patch, depths.data()[i], normal).likeness;
          }
          return 0;
        });
        return float_rows(std::move(likeness));
      },
      "first"_a, "second"_a, "rotation"_a, "translation"_a, "directions"_a, "depths"_a,
      "normals"_a);
}

}  // namespace epi360
