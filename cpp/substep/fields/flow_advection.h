// Advection in a closed-form flow: tiles of particles as structure of arrays take many steps while
// they are in the first-level cache. Instantiated for the flows of flows.h.
#pragma once

#include "substep/fields/flows.h"
#include "substep/fields/steps.h"

namespace substep::fields {

// Moves `count` particles (rows of x) by the steps; x_new may not overlap x. Throws NonFiniteError
// with the first step that fails, and in it the first particle.
template <class T, class Flow>
void advect_flow(const Flow& flow, std::string_view method, const T* x, T* x_new,
                 std::int64_t count, const Steps& steps, int threads);

// velocities u of the rows x at time t.
template <class T, class Flow>
void sample_flow(const Flow& flow, double t, const T* x, T* u, std::int64_t count, int threads);

}  // namespace substep::fields
