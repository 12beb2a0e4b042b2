// The systems of few components. CMakeLists.txt has the vectorizer off for this file: four numbers
// that go back and forth between scalars and a vector wait for their stores, which doubles the
// time.
#include "substep/ode/systems/systems.h"

namespace substep::ode {

template class StaticSystem<Lorenz, 3>;
template class StaticSystem<Arenstorf, 4>;
template class StaticSystem<Kepler, 4>;
template class StaticSystem<HenonHeiles, 4>;
template class StaticSystem<VanDerPol, 2>;
template class StaticSystem<Pendulum, 2>;
template class StaticSystem<HarmonicOscillator, 2>;

}  // namespace substep::ode
