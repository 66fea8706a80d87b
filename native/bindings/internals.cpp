// SPDX-License-Identifier: BSD-3-Clause
// Parts of the core that tests look at one by one: epi360._core.internals.
#include "bindings/arrays.h"

namespace epi360 {

void bind_testimony(nb::module_& m);  // testimony.cpp

void bind_internals(nb::module_& m) {
  nb::module_ internals = m.def_submodule("internals");
  bind_testimony(internals);
}

}  // namespace epi360
