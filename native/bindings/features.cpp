// SPDX-License-Identifier: BSD-3-Clause
#include <nanobind/stl/optional.h>

#include <algorithm>

#include "bindings/arrays.h"
#include "core/features/nearest.h"
#include "core/features/sift.h"

using namespace nanobind::literals;

namespace epi360 {
namespace {

using Grey = nb::ndarray<const unsigned char, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

nb::object descriptor_rows(std::vector<unsigned char> values) {
  auto* owned = new std::vector<unsigned char>(std::move(values));
  nb::capsule owner(owned,
                    [](void* p) noexcept { delete static_cast<std::vector<unsigned char>*>(p); });
  const std::size_t shape[2] = {owned->size() / 128, 128};
  return nb::ndarray<nb::numpy, unsigned char>(owned->data(), 2, shape, owner).cast();
}

using Floats = nb::ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

Descriptors to_descriptors(const Floats& rows) {
  return {rows.data(), static_cast<int>(rows.shape(0)), static_cast<int>(rows.shape(1))};
}

template <typename Number>
nb::object array_of(std::vector<Number> values) {
  auto* owned = new std::vector<Number>(std::move(values));
  nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<Number>*>(p); });
  return nb::ndarray<nb::numpy, Number, nb::ndim<1>>(owned->data(), {owned->size()}, owner).cast();
}

}  // namespace

void bind_features(nb::module_& m) {
  m.def(
      "find_sift",
      [](Grey picture, std::optional<Grey> mask, double contrast_threshold) {
        if (mask && (mask->shape(0) != picture.shape(0) || mask->shape(1) != picture.shape(1))) {
          throw nb::value_error("the mask must have the size of the picture");
        }
        const Picture given{picture.data(), mask ? mask->data() : nullptr,
                            static_cast<int>(picture.shape(1)), static_cast<int>(picture.shape(0))};
        SiftKeypoints found = unlocked([&] { return find_sift(given, contrast_threshold); });
        const std::size_t count = found.rows.size() / 4;
        return nb::make_tuple(copied(found.rows.data(), count, 4),
                              descriptor_rows(std::move(found.descriptors)));
      },
      "picture"_a, "mask"_a.none(), "contrast_threshold"_a);
  m.def(
      "two_nearest",
      [](Floats queries, Floats targets) -> nb::object {
        const Descriptors first = to_descriptors(queries), second = to_descriptors(targets);
        if (!unlocked([&] { return can_compare(first, second); })) return nb::none();
        Nearest found = unlocked([&] { return two_nearest(first, second); });
        return nb::make_tuple(array_of(std::move(found.nearest)), array_of(std::move(found.best)),
                              array_of(std::move(found.second)), array_of(std::move(found.others)));
      },
      "queries"_a, "targets"_a);
}

}  // namespace epi360
