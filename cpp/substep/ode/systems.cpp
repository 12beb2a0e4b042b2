#include "substep/ode/systems.h"

namespace substep::ode {

Pleiades::Pleiades(const double* masses) {
  for (int i = 0; i < 11; ++i) mass_[i] = masses[i % 7];
}

template class StaticSystem<Lorenz, 3>;
template class StaticSystem<Arenstorf, 4>;
template class StaticSystem<Kepler, 4>;
template class StaticSystem<HenonHeiles, 4>;
template class StaticSystem<VanDerPol, 2>;
template class StaticSystem<Pendulum, 2>;
template class StaticSystem<HarmonicOscillator, 2>;
template class StaticSystem<Pleiades, 28>;

}  // namespace substep::ode
