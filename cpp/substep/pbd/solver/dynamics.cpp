#include "substep/pbd/solver/dynamics.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>

#include "substep/core/errors.h"
#include "substep/core/lanes.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::pbd {
namespace {

constexpr std::size_t kPhasesAtOnce = 512;
constexpr std::int64_t kGatherGrain = 2048;

Triple middle(std::span<const Triple> x) {
  Triple m{0, 0, 0};
  if (x.empty()) return m;
  for (std::size_t k = 0; k < 3; ++k) {
    double low = x[0][k], high = x[0][k];
    for (const Triple& p : x) {
      low = std::min(low, p[k]);
      high = std::max(high, p[k]);
    }
    m[k] = 0.5 * low + 0.5 * high;
  }
  return m;
}

template <class T>
std::vector<std::unique_ptr<T>> clones(const std::vector<std::unique_ptr<T>>& list) {
  std::vector<std::unique_ptr<T>> copies;
  for (const auto& item : list) copies.push_back(item->clone());
  return copies;
}

// Whole rows in vectors R: as many as fit.
template <class R>
SUBSTEP_INLINE R rows(const std::vector<Point<Lane<R>>>& list, std::size_t i) {
  return load<R>(&list[i].x);
}
template <class R>
SUBSTEP_INLINE void set_rows(std::vector<Point<Lane<R>>>& list, std::size_t i, const R& values) {
  std::memcpy(&list[i], &values, sizeof values);
}
template <class R>
SUBSTEP_INLINE R repeated(const Point<Lane<R>>& row) {
  R v;
  for (unsigned k = 0; k < sizeof(R) / sizeof(row); ++k) {
    v[4 * k] = row.x, v[4 * k + 1] = row.y, v[4 * k + 2] = row.z, v[4 * k + 3] = row.w;
  }
  return v;
}
// The w of each row, four times.
template <class R>
SUBSTEP_INLINE R masses(const R& v) {
  if constexpr (sizeof(R) == 4 * sizeof(Point<Lane<R>>)) {
    return __builtin_shufflevector(v, v, 3, 3, 3, 3, 7, 7, 7, 7, 11, 11, 11, 11, 15, 15, 15, 15);
  } else if constexpr (sizeof(R) == 2 * sizeof(Point<Lane<R>>)) {
    return __builtin_shufflevector(v, v, 3, 3, 3, 3, 7, 7, 7, 7);
  } else {
    return __builtin_shufflevector(v, v, 3, 3, 3, 3);
  }
}
// body(begin, end, R) for the rows that fill vectors R, and for those that are left.
template <class Real, class Body>
SUBSTEP_INLINE void for_rows(std::size_t begin, std::size_t end, const Body& body) {
  using Row = Vector<Real, 4 * sizeof(Real)>;
  using R = Vector<Real, std::max<int>(kVectorBytes, sizeof(Row))>;
  const std::size_t middle = end - (end - begin) % (sizeof(R) / sizeof(Row));
  body(begin, middle, R{});
  body(middle, end, Row{});
}

template <class Real>
bool finite(const Point<Real>& p) {
  return std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z);
}

}  // namespace

template <class Real>
Dynamics<Real>::Dynamics(std::span<const Triple> positions, std::span<const Triple> velocities,
                         std::span<const double> masses, std::span<const std::uint8_t> pinned,
                         std::vector<std::unique_ptr<Group<Real>>> groups,
                         std::vector<geometry::Collider> colliders, const Options& given)
    : options(given),
      count_(static_cast<std::int64_t>(positions.size())),
      origin_(middle(positions)),
      groups_(std::move(groups)) {
  if (!colliders.empty()) {
    contact.emplace(std::move(colliders), geometry::Vec3(origin_[0], origin_[1], origin_[2]),
                    options.margin, options.dimension);
  }
  std::vector<Point<Real>> rows;
  rows.reserve(positions.size());
  for (const Triple& p : positions) rows.push_back(relative(p));
  partition_ = make_partition<Real>(std::span<const Point<Real>>(rows), options.patch_size);
  const std::size_t n = positions.size();
  x_.assign(n + 1, {});
  x_old_.assign(n + 1, {});
  v_.assign(n, {});
  saved_x_.assign(n, {});
  saved_v_.assign(n, {});
  saved_.assign(usize(partition_.patches()), 0);
  for (std::size_t slot = 0; slot < n; ++slot) {
    const auto id = usize(partition_.id[slot]);
    const auto inverse = static_cast<Real>(1 / masses[id]);
    x_[slot] = rows[id];
    x_[slot].w = inverse;
    const Triple& u = velocities[id];
    v_[slot] = {static_cast<Real>(u[0]), static_cast<Real>(u[1]), static_cast<Real>(u[2]), inverse};
  }
  set_pinned(pinned);
  for (auto& group : groups_) group->attach(partition_);
  if (options.jacobi) prepare_jacobi();
}

template <class Real>
Dynamics<Real>::Dynamics(const Dynamics& other)
    : options(other.options),
      time(other.time),
      projector(other.projector ? other.projector->clone() : nullptr),
      contact(other.contact),
      count_(other.count_),
      origin_(other.origin_),
      partition_(other.partition_),
      x_(other.x_),
      x_old_(other.x_old_),
      v_(other.v_),
      force_(other.force_),
      target_(other.target_),
      saved_x_(other.saved_x_.size()),
      saved_v_(other.saved_v_.size()),
      saved_(other.saved_),
      groups_(clones(other.groups_)),
      correction_start_(other.correction_start_),
      corrections_(other.corrections_),
      held_start_(other.held_start_),
      held_(other.held_),
      splits_(other.splits_),
      last_h_(other.last_h_),
      skipped_(other.skipped_) {}

template <class Real>
Point<Real> Dynamics<Real>::relative(const Triple& x) const {
  return {static_cast<Real>(x[0] - origin_[0]), static_cast<Real>(x[1] - origin_[1]),
          static_cast<Real>(x[2] - origin_[2]), 0};
}

// Which corrections a particle gets, and in how many constraints its mass is split.
template <class Real>
void Dynamics<Real>::prepare_jacobi() {
  const auto n = usize(count_);
  splits_.assign(n + 1, 0);
  correction_start_.assign(1, 0);
  std::vector<std::int32_t> holders;  // of the rows of all groups
  for (const auto& group : groups_) {
    const std::vector<std::int32_t> own = group->holders();
    holders.insert(holders.end(), own.begin(), own.end());
    correction_start_.push_back(holders.size());
  }
  for (const std::int32_t slot : holders) {
    if (slot >= 0) ++splits_[usize(slot)];
  }
  corrections_.assign(correction_start_.back(), {});
  held_start_.assign(n + 1, 0);
  for (std::size_t slot = 0; slot < n; ++slot) {
    held_start_[slot + 1] = held_start_[slot] + splits_[slot];
  }
  held_.resize(usize(held_start_[n]));
  std::vector<std::int64_t> next(held_start_.begin(), held_start_.end() - 1);
  for (std::size_t row = 0; row < holders.size(); ++row) {
    if (holders[row] < 0) continue;
    const auto at = usize(next[usize(holders[row])]++);
    held_[at] = static_cast<std::int64_t>(row);
  }
}

template <class Real>
Sweep<Real> Dynamics<Real>::sweep(int substep, int iteration) const {
  return {.x = const_cast<Point<Real>*>(x_.data()),
          .x_old = x_old_.data(),
          .splits = splits_.data(),
          .count = count_,
          .h = h_,
          .substep = substep,
          .substeps = options.substeps,
          .iteration = iteration,
          .iterations = options.iterations,
          .relaxation = options.relaxation};
}

template <class Real>
void Dynamics<Real>::step(double dt) {
  dt_ = dt;
  h_ = dt / options.substeps;
  skips_ = 0;
  std::fill(saved_.begin(), saved_.end(), std::uint8_t{0});
  phases_.clear();
  for (auto& group : groups_) group->begin_step(h_, options.substeps, options.iterations);
  if (projector) projector->begin_step(h_, options.substeps, options.iterations);
  const auto colliders = contact ? contact->colliders : std::vector<geometry::Collider>{};
  try {
    run_step();
  } catch (...) {
    phases_.clear();
    restore_saved();
    for (auto& group : groups_) group->end_step(false);
    if (contact) contact->colliders = colliders;
    throw;
  }
  for (auto& group : groups_) group->end_step(true);
  end_pins();
  force_.clear();
  skipped_ = skips_;
  last_h_ = h_;
  time += dt;
}

template <class Real>
void Dynamics<Real>::run_step() {
  if (contact) {
    contact->threads = options.threads;
    contact->begin_step(count_);
    contact_mass_.resize(v_.size());
    for (std::size_t i = 0; i < v_.size(); ++i) contact_mass_[i] = x_[i].w > 0 ? 1 / x_[i].w : 0;
    v_old_.resize(v_.size());
  }
  std::uint8_t pending = 0;
  for (int substep = 0; substep < options.substeps; ++substep) run_substep(substep, pending);
  if (pending != 0) {
    later({.kind = Kind::patches,
           .work = pending,
           .substep = options.substeps - 1,
           .chunks = partition_.patches()});
  }
  flush();
  if (!contact) return;
  contact->end_step();
  for (const geometry::Collider& collider : contact->colliders) {
    const geometry::Exchange& given = collider.exchange();
    if (given.impulse.allFinite() && given.torque.allFinite()) continue;
    throw NonFiniteError("the impulse on an obstacle is not finite at t = " + std::to_string(time) +
                             " s: particles are too fast or too far away",
                         time);
  }
}

// Predict and project; what is left for the particles of a patch to do at the end of the substep
// waits for the next loop over patches.
template <class Real>
void Dynamics<Real>::run_substep(int substep, std::uint8_t& pending) {
  Phase patches{.kind = Kind::patches,
                .work = static_cast<std::uint8_t>(pending | kPredict),
                .substep = substep,
                .chunks = partition_.patches()};
  bool prepares = false;
  for (const auto& group : groups_) prepares |= group->prepares();
  if (contact) {
    std::copy(v_.begin(), v_.end(), v_old_.begin());
    bodies_.begin_substep(*contact, h_);
  }
  if (prepares) {
    run(patches);
    patches.work = 0;
    for (auto& group : groups_) {
      if (group->prepares()) group->prepare(sweep(substep, 0), options.threads);
    }
  }
  const bool sweeps_patches = !options.jacobi && !projector;
  for (int iteration = 0; iteration < options.iterations; ++iteration) {
    patches.iteration = iteration;
    if (sweeps_patches) patches.work |= kProject;
    if (patches.work != 0) later(patches);
    patches.work = 0;
    if (projector) {
      flush();
      skips_ += projector->project(sweep(substep, iteration), options.threads);
    }
    if (options.jacobi) correct_groups(substep, iteration);
    sweep_groups(substep, iteration);
    if (contact) {
      flush();
      const auto n = usize(count_);
      if (substep == 0 && iteration == 0) {
        contact->clear({x_old_.data(), n}, contact_mass_, {x_.data(), n});
      }
      contact->project({x_old_.data(), n}, {x_.data(), n}, contact_mass_);
      bodies_.project(*contact, {x_old_.data(), n}, {x_.data(), n}, contact_mass_);
    }
  }
  if (prepares) {
    flush();
    for (auto& group : groups_) {
      const Sweep<Real> last = sweep(substep, options.iterations - 1);
      if (group->prepares()) group->complete(last, options.threads);
    }
  }
  pending = kFinish;
  if (!contact) return;
  patches.work = kFinish;
  run(patches);
  contact->bounce({x_old_.data(), v_.size()}, v_old_, v_, contact_mass_);
  pending = 0;
}

// What project_patch() leaves: constraints between patches, and all of groups that Jacobi does not.
template <class Real>
void Dynamics<Real>::sweep_groups(int substep, int iteration) {
  for (std::size_t g = 0; g < groups_.size(); ++g) {
    Group<Real>& group = *groups_[g];
    if (options.jacobi && group.correction_chunks() > 0) continue;
    Phase phase{
        .kind = Kind::group, .group = g, .substep = substep, .iteration = iteration, .chunks = 0};
    if (options.jacobi || projector) {
      phase.group_phase = -1;
      phase.chunks = partition_.patches();
      later(phase);
    }
    for (phase.group_phase = 0; phase.group_phase < group.phases(); ++phase.group_phase) {
      phase.chunks = group.chunks(phase.group_phase);
      if (group.serial()) {
        flush();
        for (std::int64_t chunk = 0; chunk < phase.chunks; ++chunk) work(phase, chunk);
      } else {
        later(phase);
      }
    }
  }
}

template <class Real>
void Dynamics<Real>::correct_groups(int substep, int iteration) {
  for (std::size_t g = 0; g < groups_.size(); ++g) {
    later({.kind = Kind::corrections,
           .group = g,
           .substep = substep,
           .iteration = iteration,
           .chunks = groups_[g]->correction_chunks()});
  }
  later({.kind = Kind::gather, .chunks = (count_ + kGatherGrain - 1) / kGatherGrain});
}

template <class Real>
void Dynamics<Real>::run(const Phase& phase) {
  later(phase);
  flush();
}

template <class Real>
void Dynamics<Real>::later(Phase phase) {
  if (phase.chunks == 0) return;
  phases_.push_back(phase);
  if (phases_.size() >= kPhasesAtOnce) flush();
}

template <class Real>
void Dynamics<Real>::flush() {
  std::vector<std::int64_t> chunks;
  for (const Phase& phase : phases_) chunks.push_back(phase.chunks);
  parallel_phases(
      chunks, [&](std::int64_t phase, std::int64_t chunk) { work(phases_[usize(phase)], chunk); },
      options.threads);
  phases_.clear();
}

template <class Real>
void Dynamics<Real>::work(const Phase& phase, std::int64_t chunk) {
  if (phase.kind == Kind::patches) return work_on_patch(phase, chunk);
  if (phase.kind == Kind::gather) {
    return gather(chunk * kGatherGrain, std::min(count_, (chunk + 1) * kGatherGrain));
  }
  Group<Real>& group = *groups_[phase.group];
  const Sweep<Real> s = sweep(phase.substep, phase.iteration);
  const std::int64_t skipped =
      phase.kind == Kind::corrections
          ? group.correct(chunk, s, corrections_.data() + correction_start_[phase.group])
      : phase.group_phase < 0 ? group.project_patch(chunk, s)
                              : group.project(phase.group_phase, chunk, s);
  if (skipped > 0) skips_ += skipped;
}

// Finish belongs to the substep before where a new one is predicted.
template <class Real>
void Dynamics<Real>::work_on_patch(const Phase& phase, std::int64_t patch) {
  const std::int64_t begin = partition_.patch_start[usize(patch)];
  const std::int64_t end = partition_.patch_start[usize(patch) + 1];
  if (phase.work & kFinish) {
    finish(begin, end, phase.substep - ((phase.work & kPredict) ? 1 : 0));
  }
  if (phase.work & kPredict) predict(patch, begin, end, phase.substep);
  if (phase.work & kProject) {
    std::int64_t skipped = 0;
    const Sweep<Real> s = sweep(phase.substep, phase.iteration);
    for (auto& group : groups_) skipped += group->project_patch(patch, s);
    if (skipped > 0) skips_ += skipped;
  }
}

// v += h (g + f / m) and x += h v; pinned particles have the velocity to their targets.
template <class Real>
void Dynamics<Real>::predict(std::int64_t patch, std::int64_t begin, std::int64_t end,
                             int substep) {
  const auto first = usize(begin), last = usize(end);
  if (substep == 0) {
    save(patch);
    const auto dt = static_cast<Real>(dt_);
    for (std::size_t i = first; i < last; ++i) {
      if (x_[i].w != 0) continue;
      const Point<Real> to = target_.empty() ? x_[i] : target_[i];
      v_[i] = {(to.x - x_[i].x) / dt, (to.y - x_[i].y) / dt, (to.z - x_[i].z) / dt, v_[i].w};
    }
  }
  const auto h = static_cast<Real>(h_);
  const Point<Real> fall{static_cast<Real>(h_ * options.gravity[0]),
                         static_cast<Real>(h_ * options.gravity[1]),
                         static_cast<Real>(h_ * options.gravity[2]), 0};
  for_rows<Real>(first, last, [&]<class R>(std::size_t i, std::size_t to, R) {
    const R gravity = repeated<R>(fall), way = repeated<R>({h, h, h, 0});
    for (; i < to; i += sizeof(R) / sizeof(Point<Real>)) {
      const R x = rows<R>(x_, i), w = masses<R>(x);
      R v = rows<R>(v_, i) + (w > 0 ? gravity : R{});
      if (!force_.empty()) v += way * w * rows<R>(force_, i);
      set_rows(x_old_, i, x);
      set_rows(v_, i, v);
      set_rows(x_, i, R(x + way * v));
    }
  });
}

// v = (x - x_old) / h, damped; throws where that is not finite. Written as the predicted velocity
// and what the corrections add to it, which rounding does not spoil where they are small.
template <class Real>
void Dynamics<Real>::finish(std::int64_t begin, std::int64_t end, int substep) {
  const auto first = usize(begin), last = usize(end);
  const auto h = static_cast<Real>(h_), inverse = static_cast<Real>(1 / h_);
  const auto decay = static_cast<Real>(std::exp(-options.damping * h_));
  bool wrong = false;
  for_rows<Real>(first, last, [&]<class R>(std::size_t i, std::size_t to, R) {
    const R way = repeated<R>({h, h, h, 0}), rate = repeated<R>({inverse, inverse, inverse, 0});
    const R free = repeated<R>({decay, decay, decay, 1}), pinned = repeated<R>({1, 1, 1, 1});
    R check{};
    for (; i < to; i += sizeof(R) / sizeof(Point<Real>)) {
      const R x = rows<R>(x_, i), v = rows<R>(v_, i);
      const R correction = x - (rows<R>(x_old_, i) + way * v);
      const R after = (v + rate * correction) * (masses<R>(x) > 0 ? free : pinned);
      set_rows(v_, i, after);
      check += after * 0;  // 0, or NaN
    }
    wrong |= any(check != 0);
  });
  if (!wrong) return;
  for (std::size_t i = first; i < last; ++i) {
    if (finite(v_[i])) continue;
    const double at = time + (substep + 1) * h_;
    const std::int32_t id = partition_.id[i];
    throw NonFiniteError("particle " + std::to_string(id) +
                             " is not finite at t = " + std::to_string(at) + " s (substep " +
                             std::to_string(substep) + "); take smaller steps or more substeps",
                         at, id, substep);
  }
}

// The sum of a particle's corrections, in their order.
template <class Real>
void Dynamics<Real>::gather(std::int64_t begin, std::int64_t end) {
  for (auto i = usize(begin); i < usize(end); ++i) {
    Point<Real> sum{};
    for (std::int64_t k = held_start_[i]; k < held_start_[i + 1]; ++k) {
      const Point<Real>& c = corrections_[usize(held_[usize(k)])];
      sum.x += c.x;
      sum.y += c.y;
      sum.z += c.z;
    }
    x_[i].x += sum.x;
    x_[i].y += sum.y;
    x_[i].z += sum.z;
  }
}

// Pinned particles arrive exactly.
template <class Real>
void Dynamics<Real>::end_pins() {
  for (std::size_t i = 0; i < usize(count_); ++i) {
    if (x_[i].w != 0) continue;
    const Point<Real>& to = target_.empty() ? saved_x_[i] : target_[i];
    x_[i] = {to.x, to.y, to.z, 0};
  }
}

// The state that a failed step goes back to, patch by patch.
template <class Real>
void Dynamics<Real>::save(std::int64_t patch) {
  const auto p = usize(patch);
  const std::int64_t begin = partition_.patch_start[p], end = partition_.patch_start[p + 1];
  std::copy(x_.begin() + begin, x_.begin() + end, saved_x_.begin() + begin);
  std::copy(v_.begin() + begin, v_.begin() + end, saved_v_.begin() + begin);
  saved_[p] = 1;
}

template <class Real>
void Dynamics<Real>::restore_saved() {
  for (std::size_t p = 0; p < saved_.size(); ++p) {
    if (!saved_[p]) continue;
    const std::int64_t begin = partition_.patch_start[p], end = partition_.patch_start[p + 1];
    std::copy(saved_x_.begin() + begin, saved_x_.begin() + end, x_.begin() + begin);
    std::copy(saved_v_.begin() + begin, saved_v_.begin() + end, v_.begin() + begin);
  }
}

template <class Real>
void Dynamics<Real>::positions(std::span<Triple> out) const {
  for (std::size_t i = 0; i < usize(count_); ++i) {
    out[usize(partition_.id[i])] = {origin_[0] + static_cast<double>(x_[i].x),
                                    origin_[1] + static_cast<double>(x_[i].y),
                                    origin_[2] + static_cast<double>(x_[i].z)};
  }
}

namespace {

template <class Real>
void write_vectors(const std::vector<Point<Real>>& rows, const Partition& partition,
                   std::span<Triple> out) {
  for (std::size_t i = 0; i < out.size(); ++i) {
    Triple& to = out[usize(partition.id[i])];
    to = rows.empty() ? Triple{0, 0, 0}
                      : Triple{static_cast<double>(rows[i].x), static_cast<double>(rows[i].y),
                               static_cast<double>(rows[i].z)};
  }
}

}  // namespace

template <class Real>
void Dynamics<Real>::velocities(std::span<Triple> out) const {
  write_vectors(v_, partition_, out);
}

template <class Real>
void Dynamics<Real>::set_positions(std::span<const std::int64_t> ids,
                                   std::span<const Triple> values) {
  for (std::size_t k = 0; k < ids.size(); ++k) {
    Point<Real>& x = x_[row(ids[k])];
    const Point<Real> p = relative(values[k]);
    x = {p.x, p.y, p.z, x.w};
  }
}

template <class Real>
void Dynamics<Real>::set_velocities(std::span<const std::int64_t> ids,
                                    std::span<const Triple> values) {
  for (std::size_t k = 0; k < ids.size(); ++k) {
    Point<Real>& v = v_[row(ids[k])];
    v = {static_cast<Real>(values[k][0]), static_cast<Real>(values[k][1]),
         static_cast<Real>(values[k][2]), v.w};
  }
}

template <class Real>
void Dynamics<Real>::set_forces(std::span<const Triple> values) {
  force_.clear();
  if (std::all_of(values.begin(), values.end(), [](const Triple& f) { return f == Triple{}; })) {
    return;
  }
  force_.assign(values.size(), {});
  for (std::size_t id = 0; id < values.size(); ++id) {
    force_[row(static_cast<std::int64_t>(id))] = {static_cast<Real>(values[id][0]),
                                                  static_cast<Real>(values[id][1]),
                                                  static_cast<Real>(values[id][2]), 0};
  }
}

template <class Real>
void Dynamics<Real>::forces(std::span<Triple> out) const {
  write_vectors(force_, partition_, out);
}

template <class Real>
void Dynamics<Real>::set_targets(std::span<const Triple> values) {
  target_.assign(values.size(), {});
  for (std::size_t id = 0; id < values.size(); ++id) {
    target_[row(static_cast<std::int64_t>(id))] = relative(values[id]);
  }
}

template <class Real>
void Dynamics<Real>::targets(std::span<Triple> out) const {
  if (target_.empty()) return positions(out);
  write_vectors(target_, partition_, out);
  for (Triple& t : out) {
    for (std::size_t k = 0; k < 3; ++k) t[k] += origin_[k];
  }
}

template <class Real>
void Dynamics<Real>::set_pinned(std::span<const std::uint8_t> pinned) {
  for (std::size_t i = 0; i < usize(count_); ++i) {
    const bool pins = pinned[usize(partition_.id[i])] != 0;
    if (pins && x_[i].w != 0 && !target_.empty())
      target_[i] = x_[i];  // stays, until told otherwise
    x_[i].w = pins ? 0 : v_[i].w;
  }
}

template <class Real>
std::vector<std::uint8_t> Dynamics<Real>::pinned() const {
  std::vector<std::uint8_t> flags(usize(count_));
  for (std::size_t i = 0; i < flags.size(); ++i) {
    flags[usize(partition_.id[i])] = x_[i].w == 0;
  }
  return flags;
}

namespace {

template <class Real>
void write_raw(const std::vector<Point<Real>>& rows, const Partition& partition,
               std::span<Real> out) {
  for (std::size_t i = 0; i < out.size() / 3; ++i) {
    const std::size_t to = 3 * usize(partition.id[i]);
    out[to] = rows[i].x, out[to + 1] = rows[i].y, out[to + 2] = rows[i].z;
  }
}
template <class Real>
void read_raw(std::span<const Real> values, const Partition& partition,
              std::vector<Point<Real>>& rows) {
  for (std::size_t i = 0; i < values.size() / 3; ++i) {
    const std::size_t at = 3 * usize(partition.id[i]);
    rows[i] = {values[at], values[at + 1], values[at + 2], rows[i].w};
  }
}

}  // namespace

template <class Real>
void Dynamics<Real>::raw(std::span<Real> positions, std::span<Real> velocities,
                         std::span<Real> targets) const {
  write_raw(x_, partition_, positions);
  write_raw(v_, partition_, velocities);
  write_raw(target_, partition_, targets);
}

template <class Real>
void Dynamics<Real>::set_raw(std::span<const Real> positions, std::span<const Real> velocities,
                             std::span<const Real> targets) {
  target_.assign(targets.size() / 3, {});
  read_raw(positions, partition_, x_);
  read_raw(velocities, partition_, v_);
  read_raw(targets, partition_, target_);
}

template <class Real>
void Dynamics<Real>::values(std::size_t group, std::span<double> c) const {
  groups_[group]->values(sweep(0, 0), c);
}
template <class Real>
void Dynamics<Real>::multipliers(std::size_t group, std::span<double> lambda) const {
  groups_[group]->multipliers(lambda);
}

template <class Real>
double Dynamics<Real>::elastic_energy() const {
  double sum = 0;
  for (const auto& group : groups_) sum += group->energy(sweep(0, 0));
  return sum;
}

template class Dynamics<float>;
template class Dynamics<double>;

}  // namespace substep::pbd
