// How particles are put into a Solver, taken out and set.
#include <algorithm>
#include <limits>
#include <string>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/mpm/particles/particle_loop.h"
#include "substep/mpm/particles/particle_rows.h"
#include "substep/mpm/solver/solver.h"

namespace substep::mpm {
namespace {

// One particle of a material, undeformed and still; volume and id are to be set.
template <class Real, int D>
ParticleRows<Real, D> particle_at_rest(const AnyMaterial& material) {
  ParticleRows<Real, D> row;
  row.blocks.resize(1);
  row.state.resize(D);
  row.motion.resize(ParticleGroup<Real, D>::kMotion);
  row.volume.resize(1);
  row.ids.resize(1);
  std::visit(
      [&]<class M>(const M&) {
        for (const double f : initial_fields<M, D>()) row.state.push_back(static_cast<Real>(f));
      },
      material);
  return row;
}

}  // namespace

// What change() does to the energy was supplied from outside.
template <class Real, int D>
template <class Change>
void Solver<Real, D>::supply(const Change& change) {
  const double before = sums().energy();
  whole([&] {
    change();
    clock_.supply(sums().energy() - before);
  });
}

// Takes out what has left the bounds, or holds it there, at rest.
template <class Real, int D>
void Solver<Real, D>::hold_escaped() {
  constexpr int kMotion = ParticleGroup<Real, D>::kMotion;
  supply([&] {
    std::vector<ParticleRows<Real, D>> all = rows();
    for (ParticleRows<Real, D>& group : all) {
      std::vector<std::uint8_t> stays(group.ids.size(), 1);
      for (std::size_t i = 0; i < group.ids.size(); ++i) {
        const Vec3 x = position(group, i, options_.cell);
        if (!escapes(x)) continue;
        if (options_.on_escape == OnEscape::kRemove) {
          stays[i] = 0;
          ++report_.removed;
        } else {
          set_position(group, i, options_.cell, x.cwiseMax(bounds_[0]).cwiseMin(bounds_[1]));
          std::fill_n(group.motion.begin() + static_cast<std::ptrdiff_t>(i) * kMotion, kMotion,
                      Real{});
          ++report_.clamped;
        }
      }
      keep(group, stays);
    }
    sort_again(all);
  });
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
  supply([&] {
    std::vector<ParticleRows<Real, D>> all = rows(), fresh;
    for (const AnyMaterial& m : options_.materials) fresh.push_back(particle_at_rest<Real, D>(m));
    std::vector<std::size_t> counts(all.size(), 0);
    for (const std::int32_t m : material) ++counts[usize(m)];
    for (std::size_t g = 0; g < all.size(); ++g) {
      reserve(all[g], all[g].ids.size() + counts[g], fresh[g].state.size());
    }
    for (std::size_t i = 0; i < x.size(); ++i) {
      const auto g = usize(material[i]);
      ParticleRows<Real, D>& row = fresh[g];
      set_position(row, 0, options_.cell, x[i]);
      for (int d = 0; d < D; ++d) {
        row.motion[usize(d)] = static_cast<Real>(v[i][d]);
      }
      row.volume[0] = static_cast<Real>(volume[i]);
      row.ids[0] = static_cast<std::int32_t>(first + static_cast<std::int64_t>(i));
      append(all[g], row, 0);
    }
    std::vector<Vec3> forces = forces_;
    if (!forces.empty()) forces.resize(forces.size() + x.size(), Vec3::Zero());
    sort_again(all);
    forces_.swap(forces);
    clock_.next_id = first + static_cast<std::int64_t>(x.size());
  });
  return first;
}

template <class Real, int D>
void Solver<Real, D>::remove(std::span<const std::uint8_t> flags) {
  supply([&] {
    const Places places = places_of_ids();
    std::vector<ParticleRows<Real, D>> all = rows();
    for (ParticleRows<Real, D>& group : all) {
      std::vector<std::uint8_t> stays;
      for (const std::int32_t id : group.ids) {
        stays.push_back(flags[usize(places[id])] == 0);
      }
      keep(group, stays);
    }
    std::vector<Vec3> left;
    for (std::size_t i = 0; i < forces_.size(); ++i) {
      if (flags[i] == 0) left.push_back(forces_[i]);
    }
    sort_again(all);
    forces_.swap(left);
  });
}

// What came out of emitters since the last time, and goes into sinks.
template <class Real, int D>
void Solver<Real, D>::let_flow() {
  for (std::size_t k = 0; k < flow_.emitters.size(); ++k) {
    const geometry::Emitted came = flow_.emitters[k].let_out(flow_.counts.layers[k], clock_.time);
    if (std::any_of(came.x.begin(), came.x.end(), [&](const Vec3& x) { return escapes(x); })) {
      raise("emitters[" + std::to_string(k) +
                "]: what comes out is beyond the bounds when the step ends; take shorter ones",
            -1);
    }
    add(came.x, came.v, came.kinds, came.volumes);
  }
  for (std::size_t k = 0; k < flow_.sinks.size(); ++k) {
    flow_.counts.absorbed[k] += absorb(*flow_.sinks[k]);
  }
}

// Takes out what lies inside; returns how many.
template <class Real, int D>
std::int64_t Solver<Real, D>::absorb(const geometry::Collider& region) {
  const std::vector<double> x = positions();
  std::vector<std::uint8_t> inside(usize(size()));
  parallel_for(
      size(), 1024,
      [&](std::int64_t begin, std::int64_t end) {
        for (auto i = usize(begin); i < usize(end); ++i) {
          Vec3 at = Vec3::Zero();
          std::copy_n(x.data() + i * D, D, at.data());
          inside[i] = region.signed_distance(at).value < 0;
        }
      },
      options_.threads);
  const auto n = std::count(inside.begin(), inside.end(), 1);
  if (n > 0) remove(inside);
  return n;
}

// Of an id: the last k whose places[k] is its place among the particles of a material (or of all),
// or -1.
template <class Real, int D>
auto Solver<Real, D>::given_of_ids(std::span<const std::int64_t> places, int material) const {
  std::vector<std::int64_t> given(usize(size(material)), -1);
  for (std::size_t k = 0; k < places.size(); ++k) {
    given[usize(places[k])] = static_cast<std::int64_t>(k);
  }
  return [given = std::move(given), of = places_of_ids(material)](std::int32_t id) {
    const std::int32_t place = of[id];
    return place < 0 ? std::int64_t{-1} : given[usize(place)];
  };
}

// write(slot, k) for the particle at places[k], for each k; the last of equal places counts.
template <class Real, int D>
template <class Write>
void Solver<Real, D>::write(std::span<const std::int64_t> places, const Write& write,
                            int material) {
  const auto given = given_of_ids(places, material);
  // Lanes after the last particle of a block repeat it.
  for_packets(
      particles_,
      [&](std::size_t g, std::int64_t p, std::int32_t block, int count) {
        for (int lane = 0; lane < kLanes<Real>; ++lane) {
          const Slot owner{g, p, std::min(lane, count - 1), block};
          const std::int64_t k = given(id_of(particles_, owner));
          if (k >= 0) write(Slot{g, p, lane, block}, usize(k));
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
  supply([&] {
    const auto given = given_of_ids(places, kAll);
    std::vector<ParticleRows<Real, D>> all = rows();
    for (ParticleRows<Real, D>& group : all) {
      for (std::size_t i = 0; i < group.ids.size(); ++i) {
        const std::int64_t k = given(group.ids[i]);
        if (k >= 0) set_position(group, i, options_.cell, x[usize(k)]);
      }
    }
    sort_again(all);
  });
}

template <class Real, int D>
void Solver<Real, D>::set_velocities(std::span<const Vec3> v,
                                     std::span<const std::int64_t> places) {
  supply([&] {
    write(places, [&](const Slot& s, std::size_t k) {
      for (int d = 0; d < D; ++d) motion_of(particles_, s, d) = static_cast<Real>(v[k][d]);
    });
  });
}

template <class Real, int D>
void Solver<Real, D>::set_affine(std::span<const double> C, std::span<const std::int64_t> places) {
  whole([&] {
    write(places, [&](const Slot& s, std::size_t k) {
      for (std::size_t i = 0; i < D * D; ++i) {
        motion_of(particles_, s, D + static_cast<int>(i)) = static_cast<Real>(C[k * D * D + i]);
      }
    });
  });
}

template <class Real, int D>
void Solver<Real, D>::set_material_fields(int material, std::span<const double> fields,
                                          std::span<const std::int64_t> places) {
  const auto width = usize(field_count(material));
  supply([&] {
    write(
        places,
        [&](const Slot& s, std::size_t k) {
          for (std::size_t f = 0; f < width; ++f) {
            state_of(particles_, s, D + static_cast<int>(f)) =
                static_cast<Real>(fields[k * width + f]);
          }
        },
        material);
  });
}

template <class Real, int D>
void Solver<Real, D>::set_forces(std::span<const Vec3> forces,
                                 std::span<const std::int64_t> places) {
  forces_.resize(usize(size()), Vec3::Zero());
  for (std::size_t k = 0; k < places.size(); ++k) {
    forces_[usize(places[k])] = forces[k];
  }
}

template class Solver<float, 2>;
template class Solver<float, 3>;
template class Solver<double, 2>;
template class Solver<double, 3>;

}  // namespace substep::mpm
