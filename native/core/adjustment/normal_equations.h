// SPDX-License-Identifier: BSD-3-Clause
// The hot loops of window.h: costs, normal equations and the step that they ask for.
#pragma once

#include <limits>

#include "core/adjustment/window.h"

namespace epi360 {

constexpr std::uint32_t kNoSlot = std::numeric_limits<std::uint32_t>::max();

// Sum of the losses in units of the noise's variance.
double window_cost(const Window& w, const WindowOptions& options, const double* rotations,
                   const double* translations, const double* points);

// Slots, profile and the sizes of all arrays: once, as they depend on who sees what alone.
void lay_out(const Window& w, const WindowOptions& options, WindowWorkspace& s);

// All blocks at the current poses and points.
void linearise(const Window& w, const WindowOptions& options, WindowWorkspace& s);

// pose_steps (w, d of each slot) and the points after the step (trial_points), where each block is
// damped by a share of itself. False if the system is not positive.
bool solve_damped(const Window& w, const WindowOptions& options, double damping,
                  WindowWorkspace& s);

}  // namespace epi360
