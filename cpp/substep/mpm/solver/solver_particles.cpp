// What a Solver tells of its particles.
#include <utility>

#include "substep/core/usize.h"
#include "substep/mpm/particles/particle_loop.h"
#include "substep/mpm/solver/solver.h"

namespace substep::mpm {

template <class Real, int D>
std::int64_t Solver<Real, D>::size(int material) const {
  std::int64_t n = 0;
  for (std::size_t g = 0; g < particles_.groups.size(); ++g) {
    if (material == kAll || g == usize(material)) n += particles_.groups[g].count;
  }
  return n;
}

// Of the particles of a material, or of all.
template <class Real, int D>
Places Solver<Real, D>::places_of_ids(int material) const {
  const bool by_table = Places::wants_table(clock_.next_id, size());
  std::vector<std::int32_t> found(by_table ? usize(clock_.next_id) : 0, -1);
  if (!by_table) found.reserve(usize(size(material)));
  for_particles(
      particles_,
      [&](const Slot& s) {
        if (material != kAll && s.group != usize(material)) return;
        if (by_table) {
          found[usize(id_of(particles_, s))] = 0;
        } else {
          found.push_back(id_of(particles_, s));
        }
      },
      by_table ? options_.threads : 1);
  return by_table ? Places::of_table(std::move(found)) : Places::of_ids(std::move(found));
}

// row(slot, to) writes the numbers of a particle.
template <class Real, int D>
template <class Row>
std::vector<double> Solver<Real, D>::column(std::size_t width, const Row& row, int material) const {
  const Places places = places_of_ids(material);
  std::vector<double> out(usize(size(material)) * width);
  for_particles(
      particles_,
      [&](const Slot& s) {
        const std::int32_t place = places[id_of(particles_, s)];
        if (place >= 0) row(s, out.data() + usize(place) * width);
      },
      options_.threads);
  return out;
}

template <class Real, int D>
std::vector<std::int64_t> Solver<Real, D>::ids() const {
  const Places places = places_of_ids();
  return {places.ids().begin(), places.ids().end()};
}

template <class Real, int D>
std::vector<std::int32_t> Solver<Real, D>::materials() const {
  const std::vector<double> column_of =
      column(1, [&](const Slot& s, double* to) { *to = static_cast<double>(s.group); });
  return {column_of.begin(), column_of.end()};
}

template <class Real, int D>
std::vector<double> Solver<Real, D>::positions() const {
  return column(D, [&](const Slot& s, double* to) {
    const Vec3 x = position_of(particles_, s);
    std::copy_n(x.data(), D, to);
  });
}

template <class Real, int D>
std::vector<double> Solver<Real, D>::velocities() const {
  return column(D, [&](const Slot& s, double* to) {
    for (int d = 0; d < D; ++d) to[d] = static_cast<double>(motion_of(particles_, s, d));
  });
}

template <class Real, int D>
std::vector<double> Solver<Real, D>::affine() const {
  return column(D * D, [&](const Slot& s, double* to) {
    for (int k = 0; k < D * D; ++k) to[k] = static_cast<double>(motion_of(particles_, s, D + k));
  });
}

template <class Real, int D>
std::vector<double> Solver<Real, D>::volumes() const {
  return column(1, [&](const Slot& s, double* to) {
    *to = static_cast<double>(particles_.groups[s.group].volume[s.template id_index<Real>()]);
  });
}

template <class Real, int D>
int Solver<Real, D>::field_count(int material) const {
  return particles_.groups[usize(material)].fields;
}

template <class Real, int D>
std::vector<double> Solver<Real, D>::material_fields(int material) const {
  const int width = field_count(material);
  return column(
      usize(width),
      [&](const Slot& s, double* to) {
        for (int f = 0; f < width; ++f) to[f] = static_cast<double>(state_of(particles_, s, D + f));
      },
      material);
}

template <class Real, int D>
std::vector<double> Solver<Real, D>::stresses() const {
  const Places places = places_of_ids();
  std::vector<double> out(usize(size()) * 6);
  for_packets(
      particles_,
      [&](std::size_t g, std::int64_t p, std::int32_t block, int count) {
        alignas(64) Real tau[6 * kLanes<Real>];
        packet_stress_at_rest(particles_, g, p, tau);
        for (int lane = 0; lane < count; ++lane) {
          const std::int32_t id = id_of(particles_, Slot{g, p, lane, block});
          const auto place = usize(places[id]);
          for (int k = 0; k < (D == 3 ? 6 : 4); ++k) {
            out[place * 6 + usize(k)] = static_cast<double>(tau[k * kLanes<Real> + lane]);
          }
        }
      },
      options_.threads);
  return out;
}

template <class Real, int D>
std::vector<double> Solver<Real, D>::elastic_energies() const {
  const Places places = places_of_ids();
  std::vector<double> out(usize(size()));
  for_packets(
      particles_,
      [&](std::size_t g, std::int64_t p, std::int32_t block, int count) {
        alignas(64) Real energy[kLanes<Real>];
        packet_energy(particles_, g, p, energy);
        for (int lane = 0; lane < count; ++lane) {
          const Slot s{g, p, lane, block};
          const auto place = usize(places[id_of(particles_, s)]);
          out[place] =
              static_cast<double>(particles_.groups[g].volume[s.template id_index<Real>()]) *
              static_cast<double>(energy[lane]);
        }
      },
      options_.threads);
  return out;
}

template <class Real, int D>
Diagnostics Solver<Real, D>::sums() const {
  // For order 1 the moment is not the same for all, and 0 at nodes: left out.
  const bool affine = is_affine(options_.transfer) && options_.order > 1;
  return measure(particles_, options_.gravity, affine, options_.order == 2 ? 1.0 / 4 : 1.0 / 3,
                 options_.threads);
}

template <class Real, int D>
Diagnostics Solver<Real, D>::diagnostics() const {
  Diagnostics sum = sums();
  sum.dissipated = clock_.supplied - sum.energy();
  return sum;
}

template class Solver<float, 2>;
template class Solver<float, 3>;
template class Solver<double, 2>;
template class Solver<double, 3>;

}  // namespace substep::mpm
