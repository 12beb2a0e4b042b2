#include "substep/mpm/particles/measures.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "substep/core/usize.h"
#include "substep/mpm/particles/particle_loop.h"

namespace substep::mpm {
namespace {

using geometry::Vec3;

struct Largest {
  double value = 0;
  // A number that is none counts as infinite.
  void operator+=(const Largest& other) {
    value = std::isnan(other.value) ? HUGE_VAL : std::max(value, other.value);
  }
};

template <class Real, int D>
Vector<Real>* fields_of(const Particles<Real, D>& particles, std::size_t group, std::int64_t packet,
                        Vector<Real>* copy) {
  const ParticleGroup<Real, D>& g = particles.groups[group];
  std::memcpy(copy, g.packet(packet) + D * kLanes<Real>, usize(g.fields) * sizeof(Vector<Real>));
  return copy;
}

// The admissible fields of a packet, and their stress.
template <class M, class Real, int D>
[[gnu::noinline]] void admit(const M& material, const Particles<Real, D>& particles,
                             std::size_t group, std::int64_t packet, Vector<Real>* fields,
                             SymmetricTensor<Vector<Real>, D>& tau) {
  using V = Vector<Real>;
  V* const of[1] = {fields_of(particles, group, packet, fields)};
  Tensor<V, D> C[1] = {};
  const Real* affine = particles.groups[group].motion(packet) + D * kLanes<Real>;
  for (int i = 0; i < D; ++i) {
    for (int j = 0; j < D; ++j) C[0](i, j) = load<V>(affine + (i * D + j) * kLanes<Real>);
  }
  SymmetricTensor<V, D> stress[1];
  material.template stress<V, D, 1>(of, C, 0, stress);
  tau = stress[0];
}

// Terms of C in the angular momentum about the particle: m D (C_ji - C_ij), D = moment dx^2.
template <class Real, int D>
Vec3 spin(const Particles<Real, D>& particles, const Slot& s) {
  const auto C = [&](int i, int j) {
    return static_cast<double>(motion_of(particles, s, D + i * D + j));
  };
  if constexpr (D == 3) return {C(2, 1) - C(1, 2), C(0, 2) - C(2, 0), C(1, 0) - C(0, 1)};
  return {0, 0, C(1, 0) - C(0, 1)};
}

}  // namespace

template <class Real, int D>
Diagnostics measure(const Particles<Real, D>& particles, const Vec3& gravity, bool affine,
                    double moment, int threads) {
  const double inertia = affine ? moment * particles.cell * particles.cell : 0;
  return sum_of_packets(
      particles,
      [&](std::size_t g, std::int64_t p, std::int32_t block, int count) {
        alignas(64) Real energy[kLanes<Real>];
        packet_energy(particles, g, p, energy);
        const double rho = density(particles.materials[g]);
        Diagnostics sum;
        for (int lane = 0; lane < count; ++lane) {
          const Slot s{g, p, lane, block};
          const double volume =
              static_cast<double>(particles.groups[g].volume[s.template id_index<Real>()]);
          const double m = rho * volume;
          const Vec3 x = position_of(particles, s), v = velocity_of(particles, s);
          sum.mass += m;
          sum.kinetic += 0.5 * m * v.squaredNorm();
          sum.potential -= m * gravity.dot(x);
          // What is inverted has none where its material cannot be: sums stay numbers.
          const double elastic = volume * static_cast<double>(energy[lane]);
          if (std::isfinite(elastic)) sum.elastic += elastic;
          sum.momentum += m * v;
          sum.angular_momentum += m * x.cross(v);
          if (affine) sum.angular_momentum += m * inertia * spin(particles, s);
        }
        return sum;
      },
      threads);
}

template <class Real, int D>
void packet_wave_speeds(const Particles<Real, D>& particles, std::size_t group, std::int64_t packet,
                        double* squares) {
  using V = Vector<Real>;
  std::visit(
      [&]<class M>(const M& material) {
        V fields[M::template kFields<D>];
        const V modulus =
            material.template wave_modulus<V, D>(fields_of(particles, group, packet, fields));
        for (int lane = 0; lane < kLanes<Real>; ++lane) {
          squares[lane] = static_cast<double>(modulus[lane]) / material.density;
        }
      },
      particles.materials[group]);
}

template <class Real, int D>
double wave_speed_squared(const Particles<Real, D>& particles, int threads) {
  return sum_of_packets(
             particles,
             [&](std::size_t g, std::int64_t p, std::int32_t, int) {
               double squares[kLanes<Real>];
               packet_wave_speeds(particles, g, p, squares);
               Largest largest;
               for (const double square : squares) largest += {square};
               return largest;
             },
             threads)
      .value;
}

template <class Real, int D>
double largest_speed(const Particles<Real, D>& particles, int threads) {
  return sum_of_packets(
             particles,
             [&](std::size_t g, std::int64_t p, std::int32_t, int) {
               const Real* v = particles.groups[g].motion(p);
               Largest largest;
               for (int k = 0; k < D * kLanes<Real>; ++k) {
                 largest += {std::abs(static_cast<double>(v[k]))};
               }
               return largest;
             },
             threads)
      .value;
}

template <class Real, int D>
void packet_energy(const Particles<Real, D>& particles, std::size_t group, std::int64_t packet,
                   Real* energy) {
  using V = Vector<Real>;
  std::visit(
      [&]<class M>(const M& material) {
        V fields[M::template kFields<D>];
        SymmetricTensor<V, D> tau;
        admit(material, particles, group, packet, fields, tau);
        const V psi = material.template energy_density<V, D>(fields);
        std::memcpy(energy, &psi, sizeof psi);
      },
      particles.materials[group]);
}

template <class Real, int D>
void packet_stress_at_rest(const Particles<Real, D>& particles, std::size_t group,
                           std::int64_t packet, Real* tau) {
  using V = Vector<Real>;
  std::visit(
      [&]<class M>(const M& material) {
        V fields[M::template kFields<D>];
        SymmetricTensor<V, D> stress;
        admit(material, particles, group, packet, fields, stress);
        std::memcpy(tau, stress.m, sizeof stress.m);
      },
      particles.materials[group]);
}

#define SUBSTEP_MEASURES(Real, D)                                                                  \
  template Diagnostics measure(const Particles<Real, D>&, const Vec3&, bool, double, int);         \
  template double wave_speed_squared(const Particles<Real, D>&, int);                              \
  template double largest_speed(const Particles<Real, D>&, int);                                   \
  template void packet_wave_speeds(const Particles<Real, D>&, std::size_t, std::int64_t, double*); \
  template void packet_energy(const Particles<Real, D>&, std::size_t, std::int64_t, Real*);        \
  template void packet_stress_at_rest(const Particles<Real, D>&, std::size_t, std::int64_t, Real*);
SUBSTEP_MEASURES(float, 2)
SUBSTEP_MEASURES(float, 3)
SUBSTEP_MEASURES(double, 2)
SUBSTEP_MEASURES(double, 3)

}  // namespace substep::mpm
