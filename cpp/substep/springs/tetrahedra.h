// Linear tetrahedra of an elastic solid as terms of an energy (Sifakis, Barbic, "FEM simulation of
// 3D deformable solids", SIGGRAPH 2012 courses, part 1, sections 4.1-4.4). With the edges from
// corner 0 as columns, D_m at rest and D_s now, and the gradients of the shape functions,
//
//   F = D_s D_m^-1,   V = det D_m / 6,   g_a = row a - 1 of D_m^-1 for a = 1..3,  g_0 = -sum g_a,
//
// F = sum x_a g_a^T is constant in an element, and its energy V Psi(F) has
//
//   dW/dx_a = V P g_a,   d2W/dx_a dx_b = V (g_a, g_b contracted with d2Psi/dF2).
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "substep/springs/term.h"

namespace substep::springs {

struct Tetrahedra {
  // vertices: four per tetrahedron, positively oriented (det D_m > 0); young_modulus [Pa], poisson
  // ratio and density [kg/m^3]: one per tetrahedron.
  Tetrahedra(Positions rest, std::vector<std::int32_t> vertices,
             std::span<const double> young_modulus, std::span<const double> poisson_ratio);

  std::int64_t count() const { return static_cast<std::int64_t>(vertices.size()) / 4; }

  std::vector<std::int32_t> vertices;
  // One array per component, padded with zeros to whole vectors of lanes.
  std::vector<double> inverse[9];          // D_m^-1 [1/m], row-major
  std::vector<double> volume, mu, lambda;  // V [m^3] and Lame's constants [Pa]
};

// W(x) = sum V Psi(F) for the model of that name, one of elastic_models() (elastic_energy.h).
std::shared_ptr<Term> make_elastic_term(const std::string& model,
                                        std::shared_ptr<const Tetrahedra> tetrahedra);

std::vector<std::string> elastic_models();

// D(v) of a Kelvin-Voigt solid, stresses in proportion to the rate of the Green strain:
//   D = sum V tau (mu |R|^2 + lambda/2 (tr R)^2),   R = sym(F^T dF/dt)
// with F of the lagged positions. At rest it is tau times the linear elasticity: a mode of angular
// frequency omega decays with the damping ratio tau omega / 2. Rigid motions have R = 0.
std::shared_ptr<Term> make_viscous_term(std::shared_ptr<const Tetrahedra> tetrahedra,
                                        double relaxation_time);

}  // namespace substep::springs
