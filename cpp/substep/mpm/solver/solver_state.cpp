// The state of a Solver: how it is made, told, restored, and kept within the bounds.
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/mpm/particles/particle_loop.h"
#include "substep/mpm/particles/particle_rows.h"
#include "substep/mpm/solver/solver.h"

namespace substep::mpm {
namespace {

// Blocks can be numbered this far from 0, with room for what a step moves [m].
template <int D>
double reach(double cell) {
  return cell * transfer::kBlock * static_cast<double>(transfer::BlockKey<D>::kLimit - 4);
}

}  // namespace

template <class Real, int D>
Solver<Real, D>::Solver(Options options, std::vector<geometry::Collider> colliders,
                        geometry::ParticleFlow flow)
    : options_(std::move(options)),
      grid_(options_.cell, std::move(colliders), options_.boundaries),
      implicit_(options_.cell),
      flow_(std::move(flow)),
      given_(grid_.colliders.size()) {
  const double far = reach<D>(options_.cell);
  bounds_ = {Vec3::Constant(-far), Vec3::Constant(far)};
  if (options_.bounds) {
    bounds_ = {(*options_.bounds)[0].cwiseMax(-far), (*options_.bounds)[1].cwiseMin(far)};
  }
  particles_.cell = options_.cell;
  particles_.materials = options_.materials;
  if (fast() && options_.transfer == Transfer::kAflip) particles_.flip_rate = options_.flip_rate;
  if (!grid_.colliders.empty()) particles_.walls = &grid_.particles();
  std::vector<ParticleRows<Real, D>> none(options_.materials.size());
  sort_again(none);
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
  std::vector<std::int32_t> ids;
  for (std::size_t g = 0; g < rows.size(); ++g) {
    const ParticleRows<Real, D>& group = rows[g];
    const std::size_t n = group.ids.size();
    const auto width = usize(D + particles_.groups[g].fields);
    if (group.blocks.size() != n || group.state.size() != n * width || group.volume.size() != n ||
        group.motion.size() != n * usize(ParticleGroup<Real, D>::kMotion)) {
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
      ids.push_back(id);
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
  std::sort(ids.begin(), ids.end());
  if (!ids.empty() && (ids.front() < 0 || ids.back() >= at.next_id ||
                       std::adjacent_find(ids.begin(), ids.end()) != ids.end())) {
    throw InputError("state['ids']: expected different numbers from 0 to below next_id");
  }
}

template <class Real, int D>
void Solver<Real, D>::restore(const Clock& at, const std::vector<ParticleRows<Real, D>>& rows,
                              const std::vector<Vec3>& forces,
                              const geometry::ParticleFlow::Counts& counts) {
  check_rows(at, rows);
  flow_.check(counts);
  whole([&] {
    assign(particles_, std::span<const ParticleRows<Real, D>>(rows), Order::kAsGiven,
           options_.threads);
    clock_ = at;
    particles_.trial = at.trial;
    particles_.before = at.before;
    forces_ = forces;
    flow_.counts = counts;
    report_ = {};
    layout_changed();
  });
}

// Puts rows in the place of all particles, sorted.
template <class Real, int D>
void Solver<Real, D>::sort_again(std::vector<ParticleRows<Real, D>>& rows) {
  for (auto& group : rows) place_again(group);
  assign(particles_, std::span<const ParticleRows<Real, D>>(rows), Order::kCells, options_.threads);
  clock_.drift = 0;
  layout_changed();
}

template <class Real, int D>
void Solver<Real, D>::layout_changed() {
  set_layout(grid_.walls_of(particles_.layout, options_.threads));
}

// The same with walls that were made before, which cannot fail.
template <class Real, int D>
void Solver<Real, D>::set_layout(ParticleBoundary<Real, D>&& walls) noexcept {
  grid_.set_layout(particles_.layout, std::move(walls));
  // From here on a particle may go as far as it may be from where it was sorted, and as far again.
  near_bounds_ = false;
  const double cell = options_.cell;
  for (const std::uint64_t key : particles_.layout.particle_keys) {
    const auto block = transfer::BlockKey<D>::unpack(key);
    for (int d = 0; d < D; ++d) {
      const double first = static_cast<double>(transfer::kBlock) * block[usize(d)];
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
  return id_of_greatest(particles_, [&](std::size_t g, std::int64_t p, std::int32_t block,
                                        int count, double* scores) {
    for (int lane = 0; lane < count; ++lane) {
      scores[lane] = escapes(position_of(particles_, Slot{g, p, lane, block})) ? 0 : -1;
    }
  });
}

template class Solver<float, 2>;
template class Solver<float, 3>;
template class Solver<double, 2>;
template class Solver<double, 3>;

}  // namespace substep::mpm
