#include "substep/ode/systems/catalogue.h"

#include <string>

#include "substep/core/errors.h"
#include "substep/ode/systems/brusselator.h"
#include "substep/ode/systems/stiff_systems.h"
#include "substep/ode/systems/systems.h"

namespace substep::ode {

std::shared_ptr<System> make_system(std::string_view name, std::span<const double> p) {
  const auto is = [&](std::string_view known, std::size_t parameters) {
    return name == known && p.size() == parameters;
  };
  const auto cells = [&] { return static_cast<std::int64_t>(p[0]); };
  if (is("lorenz", 3)) return std::make_shared<Lorenz>(p[0], p[1], p[2]);
  if (is("arenstorf", 1)) return std::make_shared<Arenstorf>(p[0]);
  if (is("kepler", 1)) return std::make_shared<Kepler>(p[0]);
  if (is("henon_heiles", 1)) return std::make_shared<HenonHeiles>(p[0]);
  if (is("van_der_pol", 2)) return std::make_shared<VanDerPol>(p[0], p[1]);
  if (is("pendulum", 3)) return std::make_shared<Pendulum>(p[0], p[1], p[2]);
  if (is("harmonic_oscillator", 2)) return std::make_shared<HarmonicOscillator>(p[0], p[1]);
  if (is("pleiades", 7)) return std::make_shared<Pleiades>(p.data());
  if (is("robertson", 3)) return std::make_shared<Robertson>(p[0], p[1], p[2]);
  if (is("orego", 3)) return std::make_shared<Orego>(p[0], p[1], p[2]);
  if (is("hires", 0)) return std::make_shared<Hires>();
  if (is("brusselator_1d", 4)) return std::make_shared<Brusselator1D>(cells(), p[1], p[2], p[3]);
  if (is("brusselator_2d", 6))
    return std::make_shared<Brusselator2D>(cells(), p[1], p[2], p[3], p[4], p[5]);
  throw InputError("there is no system " + std::string(name) + " of so many parameters");
}

}  // namespace substep::ode
