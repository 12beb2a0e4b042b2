// What a Solver tells of its particles, and how they are put in, taken out and set.
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "substep/core/errors.h"
#include "substep/mpm/particle_loop.h"
#include "substep/mpm/solver.h"

namespace substep::mpm {
namespace {

template <class Real, int D>
std::array<Real, D> local(double cell, const Vec3& x, transfer::Index<D>& block) {
  std::array<Real, D> in;
  for (int d = 0; d < D; ++d) {
    const Place at = place(x[d] / cell);
    block[static_cast<std::size_t>(d)] = at.block;
    in[static_cast<std::size_t>(d)] = static_cast<Real>(at.x);
  }
  return in;
}

// Blocks can be numbered this far from 0, with room for what a step moves [m].
template <int D>
double reach(double cell) {
  return cell * transfer::kBlock * static_cast<double>(transfer::BlockKey<D>::kLimit - 4);
}

}  // namespace

template <class Real, int D>
Solver<Real, D>::Solver(Options options, std::vector<geometry::Collider> colliders)
    : options_(std::move(options)),
      grid_(options_.cell, std::move(colliders), options_.boundaries),
      implicit_(options_.cell) {
  const double far = reach<D>(options_.cell);
  bounds_ = {Vec3::Constant(-far), Vec3::Constant(far)};
  if (options_.bounds) {
    bounds_ = {(*options_.bounds)[0].cwiseMax(-far), (*options_.bounds)[1].cwiseMin(far)};
  }
  particles_.cell = options_.cell;
  particles_.materials = options_.materials;
  if (!grid_.colliders.empty()) particles_.walls = &grid_.particles();
  std::vector<ParticleRows<Real, D>> none(options_.materials.size());
  sort_again(none);
}

template <class Real, int D>
std::int64_t Solver<Real, D>::size() const {
  std::int64_t n = 0;
  for (const auto& group : particles_.groups) n += group.count;
  return n;
}

// Of each id that was given: its place among those that there are, or -1.
template <class Real, int D>
std::vector<std::int32_t> Solver<Real, D>::places_of_ids() const {
  std::vector<std::int32_t> places(static_cast<std::size_t>(clock_.next_id), -1);
  for_particles(
      particles_,
      [&](const Slot& s) { places[static_cast<std::size_t>(id_of(particles_, s))] = 0; },
      options_.threads);
  std::int32_t next = 0;
  for (std::int32_t& place : places) {
    if (place == 0) place = next++;
  }
  return places;
}

// row(slot, to) writes the numbers of a particle.
template <class Real, int D>
template <class Row>
std::vector<double> Solver<Real, D>::column(std::size_t width, const Row& row) const {
  const std::vector<std::int32_t> places = places_of_ids();
  std::vector<double> out(static_cast<std::size_t>(size()) * width);
  for_particles(
      particles_,
      [&](const Slot& s) {
        const auto place =
            static_cast<std::size_t>(places[static_cast<std::size_t>(id_of(particles_, s))]);
        row(s, out.data() + place * width);
      },
      options_.threads);
  return out;
}

template <class Real, int D>
std::vector<std::int64_t> Solver<Real, D>::ids() const {
  const std::vector<std::int32_t> places = places_of_ids();
  std::vector<std::int64_t> out;
  out.reserve(static_cast<std::size_t>(size()));
  for (std::size_t id = 0; id < places.size(); ++id) {
    if (places[id] >= 0) out.push_back(static_cast<std::int64_t>(id));
  }
  return out;
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
  return particles_.groups[static_cast<std::size_t>(material)].fields;
}

template <class Real, int D>
std::vector<double> Solver<Real, D>::material_fields(int material) const {
  const auto width = static_cast<std::size_t>(field_count(material));
  const auto group = static_cast<std::size_t>(material);
  std::vector<std::int32_t> order(static_cast<std::size_t>(clock_.next_id), -1);
  for_particles(
      particles_,
      [&](const Slot& s) {
        if (s.group == group) order[static_cast<std::size_t>(id_of(particles_, s))] = 0;
      },
      options_.threads);
  std::int32_t next = 0;
  for (std::int32_t& place : order) {
    if (place == 0) place = next++;
  }
  std::vector<double> out(static_cast<std::size_t>(next) * width);
  for_particles(
      particles_,
      [&](const Slot& s) {
        if (s.group != group) return;
        const auto place =
            static_cast<std::size_t>(order[static_cast<std::size_t>(id_of(particles_, s))]);
        for (std::size_t f = 0; f < width; ++f) {
          out[place * width + f] =
              static_cast<double>(state_of(particles_, s, D + static_cast<int>(f)));
        }
      },
      options_.threads);
  return out;
}

template <class Real, int D>
std::vector<double> Solver<Real, D>::stresses() const {
  const std::vector<std::int32_t> places = places_of_ids();
  std::vector<double> out(static_cast<std::size_t>(size()) * 6);
  for_packets(
      particles_,
      [&](std::size_t g, std::int64_t p, std::int32_t block, int count) {
        alignas(64) Real tau[6 * kLanes<Real>];
        packet_stress_at_rest(particles_, g, p, tau);
        for (int lane = 0; lane < count; ++lane) {
          const std::int32_t id = id_of(particles_, Slot{g, p, lane, block});
          const auto place = static_cast<std::size_t>(places[static_cast<std::size_t>(id)]);
          for (int k = 0; k < (D == 3 ? 6 : 4); ++k) {
            out[place * 6 + static_cast<std::size_t>(k)] =
                static_cast<double>(tau[k * kLanes<Real> + lane]);
          }
        }
      },
      options_.threads);
  return out;
}

template <class Real, int D>
std::vector<double> Solver<Real, D>::elastic_energies() const {
  const std::vector<std::int32_t> places = places_of_ids();
  std::vector<double> out(static_cast<std::size_t>(size()));
  for_packets(
      particles_,
      [&](std::size_t g, std::int64_t p, std::int32_t block, int count) {
        alignas(64) Real energy[kLanes<Real>];
        packet_energy(particles_, g, p, energy);
        for (int lane = 0; lane < count; ++lane) {
          const Slot s{g, p, lane, block};
          const auto place =
              static_cast<std::size_t>(places[static_cast<std::size_t>(id_of(particles_, s))]);
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
  const bool affine = options_.transfer == Transfer::kApic && options_.order > 1;
  return measure(particles_, options_.gravity, affine, options_.order == 2 ? 1.0 / 4 : 1.0 / 3,
                 options_.threads);
}

template <class Real, int D>
Diagnostics Solver<Real, D>::diagnostics() const {
  Diagnostics sum = sums();
  sum.dissipated = clock_.supplied - sum.energy();
  return sum;
}

template <class Real, int D>
std::vector<ParticleRows<Real, D>> Solver<Real, D>::rows() const {
  std::vector<ParticleRows<Real, D>> all;
  for (std::size_t g = 0; g < particles_.groups.size(); ++g) {
    all.push_back(mpm::rows(particles_, g));
  }
  return all;
}

template <class Real, int D>
Clock Solver<Real, D>::clock() const {
  Clock now = clock_;
  now.trial = particles_.trial;
  now.before = particles_.before;
  return now;
}

// What rows() of a solver with these materials can have given.
template <class Real, int D>
void Solver<Real, D>::check_rows(const Clock& at,
                                 const std::vector<ParticleRows<Real, D>>& rows) const {
  const double drift = drift_limit(options_.order);
  if (rows.size() != options_.materials.size() || !(at.drift >= 0 && at.drift <= drift) ||
      !(at.before >= 0) || at.next_id < 0 ||
      at.next_id > std::numeric_limits<std::int32_t>::max()) {
    throw InputError("state: expected that of an object with the same materials");
  }
  std::vector<std::uint8_t> seen(static_cast<std::size_t>(at.next_id));
  for (std::size_t g = 0; g < rows.size(); ++g) {
    const ParticleRows<Real, D>& group = rows[g];
    const std::size_t n = group.ids.size();
    const auto width = static_cast<std::size_t>(D + particles_.groups[g].fields);
    if (group.blocks.size() != n || group.state.size() != n * width || group.volume.size() != n ||
        group.motion.size() != n * static_cast<std::size_t>(ParticleGroup<Real, D>::kMotion)) {
      throw InputError("state: expected that of an object with the same materials");
    }
    const auto finite = [](Real a) { return std::isfinite(a); };
    if (!std::all_of(group.state.begin(), group.state.end(), finite) ||
        !std::all_of(group.motion.begin(), group.motion.end(), finite) ||
        !std::all_of(group.volume.begin(), group.volume.end(),
                     [](Real a) { return a > 0 && std::isfinite(a); })) {
      throw InputError("state: expected finite numbers, and volumes above 0");
    }
    for (std::size_t i = 0; i < n; ++i) {
      const std::int32_t id = group.ids[i];
      if (id < 0 || id >= at.next_id || seen[static_cast<std::size_t>(id)]++ != 0) {
        throw InputError("state['ids']: expected different numbers from 0 to below next_id");
      }
      for (std::size_t d = 0; d < D; ++d) {
        const double x = static_cast<double>(group.state[i * width + d]);
        const std::int64_t block = group.blocks[i][d];
        if (!(x > kFirstPosition - drift - 0.01 && x < kFirstPosition + 4.01 + drift) ||
            std::abs(block) > transfer::BlockKey<D>::kLimit - 2) {
          throw InputError("state: particle " + std::to_string(id) + " does not lie in its block");
        }
      }
    }
  }
}

template <class Real, int D>
void Solver<Real, D>::restore(const Clock& at, const std::vector<ParticleRows<Real, D>>& rows,
                              const std::vector<Vec3>& forces) {
  check_rows(at, rows);
  assign(particles_, std::span<const ParticleRows<Real, D>>(rows), Order::kAsGiven,
         options_.threads);
  clock_ = at;
  particles_.trial = at.trial;
  particles_.before = at.before;
  forces_ = forces;
  report_ = {};
  layout_changed();
}

// Puts rows in the place of all particles, sorted.
template <class Real, int D>
void Solver<Real, D>::sort_again(std::vector<ParticleRows<Real, D>>& rows) {
  for (std::size_t g = 0; g < rows.size(); ++g) {
    const std::size_t n = rows[g].ids.size();
    const std::size_t width = n == 0 ? 0 : rows[g].state.size() / n;
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t d = 0; d < D; ++d) {
        Real& x = rows[g].state[i * width + d];
        const Place at = place(static_cast<double>(x));
        rows[g].blocks[i][d] += at.block;
        x = static_cast<Real>(at.x);
      }
    }
  }
  assign(particles_, std::span<const ParticleRows<Real, D>>(rows), Order::kCells, options_.threads);
  clock_.drift = 0;
  layout_changed();
}

template <class Real, int D>
void Solver<Real, D>::layout_changed() {
  grid_.set_layout(particles_.layout, options_.threads);
  // From here on a particle may go as far as it may be from where it was sorted, and as far again.
  near_bounds_ = false;
  const double cell = options_.cell;
  for (const std::uint64_t key : particles_.layout.particle_keys) {
    const auto block = transfer::BlockKey<D>::unpack(key);
    for (int d = 0; d < D; ++d) {
      const double first =
          static_cast<double>(transfer::kBlock) * block[static_cast<std::size_t>(d)];
      near_bounds_ |= cell * (first + kFirstPosition - 2) < bounds_[0][d] ||
                      cell * (first + kFirstPosition + 6) > bounds_[1][d];
    }
  }
}

template <class Real, int D>
bool Solver<Real, D>::escapes(const Vec3& x) const {
  for (int d = 0; d < D; ++d) {
    if (!(x[d] >= bounds_[0][d] && x[d] <= bounds_[1][d])) return true;
  }
  return false;
}

// The lowest id outside of the bounds, or -1.
template <class Real, int D>
std::int32_t Solver<Real, D>::first_escaped() const {
  std::int32_t first = -1;
  for (std::size_t b = 0; b < particles_.layout.particle_keys.size(); ++b) {
    for_packets_of_block(particles_, static_cast<std::int32_t>(b),
                         [&](std::size_t g, std::int64_t p, std::int32_t block, int count) {
                           for (int lane = 0; lane < count; ++lane) {
                             const Slot s{g, p, lane, block};
                             if (!escapes(position_of(particles_, s))) continue;
                             const std::int32_t id = id_of(particles_, s);
                             if (first < 0 || id < first) first = id;
                           }
                         });
  }
  return first;
}

// Takes out what has left the bounds, or holds it there, at rest.
template <class Real, int D>
void Solver<Real, D>::hold_escaped() {
  const double before = sums().energy();
  std::vector<ParticleRows<Real, D>> all = rows();
  for (ParticleRows<Real, D>& group : all) {
    const std::size_t n = group.ids.size();
    if (n == 0) continue;
    const std::size_t width = group.state.size() / n;
    constexpr auto kMotion = static_cast<std::size_t>(ParticleGroup<Real, D>::kMotion);
    std::size_t kept = 0;
    for (std::size_t i = 0; i < n; ++i) {
      Vec3 x = Vec3::Zero();
      for (std::size_t d = 0; d < D; ++d) {
        x[static_cast<int>(d)] =
            options_.cell * (static_cast<double>(transfer::kBlock) * group.blocks[i][d] +
                             static_cast<double>(group.state[i * width + d]));
      }
      const bool out = escapes(x);
      if (out && options_.on_escape == OnEscape::kRemove) {
        ++report_.removed;
        continue;
      }
      if (out) {
        ++report_.clamped;
        const Vec3 held = x.cwiseMax(bounds_[0]).cwiseMin(bounds_[1]);
        const auto in = local<Real, D>(options_.cell, held, group.blocks[i]);
        std::copy(in.begin(), in.end(),
                  group.state.begin() + static_cast<std::ptrdiff_t>(i * width));
        std::fill_n(group.motion.begin() + static_cast<std::ptrdiff_t>(i * kMotion), kMotion,
                    Real{});
      }
      group.blocks[kept] = group.blocks[i];
      group.ids[kept] = group.ids[i];
      group.volume[kept] = group.volume[i];
      std::copy_n(group.state.begin() + static_cast<std::ptrdiff_t>(i * width), width,
                  group.state.begin() + static_cast<std::ptrdiff_t>(kept * width));
      std::copy_n(group.motion.begin() + static_cast<std::ptrdiff_t>(i * kMotion), kMotion,
                  group.motion.begin() + static_cast<std::ptrdiff_t>(kept * kMotion));
      ++kept;
    }
    group.blocks.resize(kept);
    group.ids.resize(kept);
    group.volume.resize(kept);
    group.state.resize(kept * width);
    group.motion.resize(kept * kMotion);
  }
  sort_again(all);
  clock_.supplied += sums().energy() - before;
}

template <class Real, int D>
std::int64_t Solver<Real, D>::add(std::span<const Vec3> x, std::span<const Vec3> v,
                                  std::span<const std::int32_t> material,
                                  std::span<const double> volume) {
  const std::array<Vec3, 2> bounds = bounds_;
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (!escapes(x[i])) continue;
    throw InputError("positions[" + std::to_string(i) + "]: expected a point within the bounds, [" +
                     std::to_string(bounds[0].head(D).maxCoeff()) + ", " +
                     std::to_string(bounds[1].head(D).minCoeff()) + "] m");
  }
  const std::int64_t first = clock_.next_id;
  if (first + static_cast<std::int64_t>(x.size()) > std::numeric_limits<std::int32_t>::max()) {
    throw InputError("positions: more than 2^31 particles in all have been added");
  }
  const double before = sums().energy();
  std::vector<ParticleRows<Real, D>> all = rows();
  std::vector<std::vector<double>> initial;
  for (const AnyMaterial& m : options_.materials) {
    initial.push_back(std::visit(
        []<class M>(const M&) {
          const auto fields = initial_fields<M, D>();
          return std::vector<double>(fields.begin(), fields.end());
        },
        m));
  }
  std::vector<std::size_t> counts(all.size(), 0);
  for (const std::int32_t m : material) ++counts[static_cast<std::size_t>(m)];
  for (std::size_t g = 0; g < all.size(); ++g) {
    const std::size_t n = all[g].ids.size() + counts[g];
    all[g].blocks.reserve(n);
    all[g].ids.reserve(n);
    all[g].volume.reserve(n);
    all[g].state.reserve(n * (D + initial[g].size()));
    all[g].motion.reserve(n * static_cast<std::size_t>(ParticleGroup<Real, D>::kMotion));
  }
  for (std::size_t i = 0; i < x.size(); ++i) {
    const auto g = static_cast<std::size_t>(material[i]);
    ParticleRows<Real, D>& to = all[g];
    transfer::Index<D> block;
    const auto in = local<Real, D>(options_.cell, x[i], block);
    to.blocks.push_back(block);
    to.state.insert(to.state.end(), in.begin(), in.end());
    for (const double f : initial[g]) to.state.push_back(static_cast<Real>(f));
    for (int d = 0; d < D; ++d) to.motion.push_back(static_cast<Real>(v[i][d]));
    to.motion.resize(to.motion.size() + D * D);
    to.volume.push_back(static_cast<Real>(volume[i]));
    to.ids.push_back(static_cast<std::int32_t>(first + static_cast<std::int64_t>(i)));
  }
  if (!forces_.empty()) forces_.resize(forces_.size() + x.size(), Vec3::Zero());
  sort_again(all);
  clock_.next_id = first + static_cast<std::int64_t>(x.size());
  clock_.supplied += sums().energy() - before;
  return first;
}

template <class Real, int D>
void Solver<Real, D>::remove(std::span<const std::uint8_t> flags) {
  const double before = sums().energy();
  const std::vector<std::int32_t> places = places_of_ids();
  std::vector<ParticleRows<Real, D>> all = rows(), kept(all.size());
  for (std::size_t g = 0; g < all.size(); ++g) {
    const ParticleRows<Real, D>& from = all[g];
    ParticleRows<Real, D>& to = kept[g];
    const std::size_t n = from.ids.size();
    const std::size_t width = n == 0 ? 0 : from.state.size() / n;
    constexpr auto kMotion = static_cast<std::size_t>(ParticleGroup<Real, D>::kMotion);
    for (std::size_t i = 0; i < n; ++i) {
      if (flags[static_cast<std::size_t>(places[static_cast<std::size_t>(from.ids[i])])] != 0) {
        continue;
      }
      to.blocks.push_back(from.blocks[i]);
      to.ids.push_back(from.ids[i]);
      to.volume.push_back(from.volume[i]);
      const auto state = from.state.begin() + static_cast<std::ptrdiff_t>(i * width);
      to.state.insert(to.state.end(), state, state + static_cast<std::ptrdiff_t>(width));
      const auto motion = from.motion.begin() + static_cast<std::ptrdiff_t>(i * kMotion);
      to.motion.insert(to.motion.end(), motion, motion + static_cast<std::ptrdiff_t>(kMotion));
    }
  }
  if (!forces_.empty()) {
    std::vector<Vec3> left;
    for (std::size_t i = 0; i < forces_.size(); ++i) {
      if (flags[i] == 0) left.push_back(forces_[i]);
    }
    forces_ = left;
  }
  sort_again(kept);
  clock_.supplied += sums().energy() - before;
}

template <class Real, int D>
std::int64_t Solver<Real, D>::absorb(const geometry::Collider& region) {
  const std::vector<double> inside = column(1, [&](const Slot& s, double* to) {
    *to = region.signed_distance(position_of(particles_, s)).value < 0 ? 1 : 0;
  });
  const std::vector<std::uint8_t> flags(inside.begin(), inside.end());
  const auto n = std::count(flags.begin(), flags.end(), 1);
  if (n > 0) remove(flags);
  return n;
}

// write(slot, k) for the particle at places[k], for each k; the last of equal places counts.
template <class Real, int D>
template <class Write>
void Solver<Real, D>::write(std::span<const std::int64_t> places, const Write& write) {
  const std::vector<std::int32_t> of_id = places_of_ids();
  std::vector<std::int64_t> row(static_cast<std::size_t>(size()), -1);
  for (std::size_t k = 0; k < places.size(); ++k) {
    row[static_cast<std::size_t>(places[k])] = static_cast<std::int64_t>(k);
  }
  // Lanes after the last particle of a block repeat it.
  for_packets(
      particles_,
      [&](std::size_t g, std::int64_t p, std::int32_t block, int count) {
        for (int lane = 0; lane < kLanes<Real>; ++lane) {
          const Slot owner{g, p, std::min(lane, count - 1), block};
          const auto place = of_id[static_cast<std::size_t>(id_of(particles_, owner))];
          const std::int64_t k = row[static_cast<std::size_t>(place)];
          if (k >= 0) write(Slot{g, p, lane, block}, static_cast<std::size_t>(k));
        }
      },
      options_.threads);
}

template <class Real, int D>
void Solver<Real, D>::set_positions(std::span<const Vec3> x, std::span<const std::int64_t> places) {
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (escapes(x[i])) {
      throw InputError("values[" + std::to_string(i) + "]: expected a point within the bounds");
    }
  }
  const double before = sums().energy();
  const std::vector<std::int32_t> of_id = places_of_ids();
  std::vector<std::int64_t> row(static_cast<std::size_t>(size()), -1);
  for (std::size_t k = 0; k < places.size(); ++k) {
    row[static_cast<std::size_t>(places[k])] = static_cast<std::int64_t>(k);
  }
  std::vector<ParticleRows<Real, D>> all = rows();
  for (ParticleRows<Real, D>& group : all) {
    for (std::size_t i = 0; i < group.ids.size(); ++i) {
      const auto place = static_cast<std::size_t>(of_id[static_cast<std::size_t>(group.ids[i])]);
      if (row[place] < 0) continue;
      const auto in =
          local<Real, D>(options_.cell, x[static_cast<std::size_t>(row[place])], group.blocks[i]);
      std::copy(in.begin(), in.end(),
                group.state.begin() +
                    static_cast<std::ptrdiff_t>(i * (group.state.size() / group.ids.size())));
    }
  }
  sort_again(all);
  clock_.supplied += sums().energy() - before;
}

template <class Real, int D>
void Solver<Real, D>::set_velocities(std::span<const Vec3> v,
                                     std::span<const std::int64_t> places) {
  const double before = sums().energy();
  write(places, [&](const Slot& s, std::size_t k) {
    for (int d = 0; d < D; ++d) motion_of(particles_, s, d) = static_cast<Real>(v[k][d]);
  });
  clock_.supplied += sums().energy() - before;
}

template <class Real, int D>
void Solver<Real, D>::set_affine(std::span<const double> C, std::span<const std::int64_t> places) {
  write(places, [&](const Slot& s, std::size_t k) {
    for (std::size_t i = 0; i < D * D; ++i) {
      motion_of(particles_, s, D + static_cast<int>(i)) = static_cast<Real>(C[k * D * D + i]);
    }
  });
}

template <class Real, int D>
void Solver<Real, D>::set_material_fields(int material, std::span<const double> fields,
                                          std::span<const std::int64_t> places) {
  const double before = sums().energy();
  const std::vector<std::int32_t> of = materials();
  std::vector<std::int64_t> members;
  for (std::size_t i = 0; i < of.size(); ++i) {
    if (of[i] == material) members.push_back(static_cast<std::int64_t>(i));
  }
  std::vector<std::int64_t> all_places;
  for (const std::int64_t place : places) {
    all_places.push_back(members[static_cast<std::size_t>(place)]);
  }
  const auto width = static_cast<std::size_t>(field_count(material));
  write(all_places, [&](const Slot& s, std::size_t k) {
    for (std::size_t f = 0; f < width; ++f) {
      state_of(particles_, s, D + static_cast<int>(f)) = static_cast<Real>(fields[k * width + f]);
    }
  });
  clock_.supplied += sums().energy() - before;
}

template <class Real, int D>
void Solver<Real, D>::set_forces(std::span<const Vec3> forces,
                                 std::span<const std::int64_t> places) {
  forces_.resize(static_cast<std::size_t>(size()), Vec3::Zero());
  for (std::size_t k = 0; k < places.size(); ++k) {
    forces_[static_cast<std::size_t>(places[k])] = forces[k];
  }
}

template class Solver<float, 2>;
template class Solver<float, 3>;
template class Solver<double, 2>;
template class Solver<double, 3>;

}  // namespace substep::mpm
