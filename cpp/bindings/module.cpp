#include "bindings.h"

// Every level's module carries the same name, substep._core: a process can import one only.
PYBIND11_MODULE(_core, m) {
  m.doc() = "The native core of substep.";
  m.attr("level") = SUBSTEP_LEVEL;
  m.attr("version") = SUBSTEP_VERSION;
  bind_core(m);
  bind_owner(m);
  bind_batch(m);  // before the simulations, whose base it has
  bind_fields(m);
  bind_geometry(m);
  bind_particle_flow(m);
  bind_grid_flow(m);
  bind_linalg(m);
  bind_mpm(m);
  bind_neighbours(m);
  bind_ode(m);
  bind_pbd(m);
  bind_second_order(m);
  bind_pbf(m);
  bind_grid_liquid(m);
  bind_rigid(m);
  bind_rigid_world(m);
  bind_springs(m);
  bind_soft_body(m);
  guard_construction(m);  // of all of them
}
