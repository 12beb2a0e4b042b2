#include "substep/ode/systems/stiff_systems.h"

namespace substep::ode {

template class StaticSystem<Robertson, 3>;
template class StaticSystem<Orego, 3>;
template class StaticSystem<Hires, 8>;

}  // namespace substep::ode
