#include "substep/rigid/solver/contact_solver.h"

#include <algorithm>
#include <bit>
#include <new>
#include <type_traits>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::rigid {
namespace {

constexpr int kPacketLanes = ContactPacket::kLanes;
constexpr std::int64_t kBodies = 512;  // per chunk
constexpr std::int64_t kPackets = 16;  // per chunk, where they are independent
constexpr float kFarAway = 1e6F;       // [m]

// What copies of a task that holds references and numbers take no memory for.
class Task {
 public:
  template <class F>
  explicit Task(const F& task)
      : call_([](const void* memory, std::int64_t chunk) {
          (*static_cast<const F*>(memory))(chunk);
        }) {
    static_assert(std::is_trivially_copyable_v<F> && sizeof(F) <= sizeof memory_);
    new (memory_) F(task);
  }
  void operator()(std::int64_t chunk) const { call_(memory_, chunk); }

 private:
  alignas(8) unsigned char memory_[104];
  void (*call_)(const void*, std::int64_t);
};

// Loops over chunks, one after the other, for one call of parallel_phases.
class Phases {
 public:
  explicit Phases(std::size_t most) {
    chunks_.reserve(most);
    tasks_.reserve(most);
  }
  template <class F>
  void add(std::int64_t chunks, const F& task) {
    chunks_.push_back(chunks);
    tasks_.push_back(Task(task));
  }
  template <class F>
  void add_range(std::int64_t n, std::int64_t grain, const F& task) {
    add((n + grain - 1) / grain,
        [=](std::int64_t chunk) { task(chunk * grain, std::min(n, (chunk + 1) * grain)); });
  }
  // Of each colour the packets, colour after colour.
  template <class F>
  void add_sweep(const Sweep& sweep, const F& packet) {
    for (std::size_t f = 0; f < sweep.chunks_of_phase.size(); ++f) {
      const std::int64_t first = sweep.phase_start[f];
      add(sweep.chunks_of_phase[f], [&sweep, first, packet](std::int64_t chunk) {
        const auto c = usize(first + chunk);
        for (auto k = sweep.chunk_start[c]; k < sweep.chunk_start[c + 1]; ++k) packet(k);
      });
    }
  }
  void run(int threads) const {
    parallel_phases(
        chunks_, [this](std::int64_t phase, std::int64_t chunk) { tasks_[usize(phase)](chunk); },
        threads);
  }

 private:
  std::vector<std::int64_t> chunks_;
  std::vector<Task> tasks_;
};

// In the order of the numbers.
std::uint32_t sort_key(float x) {
  const auto bits = std::bit_cast<std::uint32_t>(x), sign = std::uint32_t{1} << 31;
  return (bits & sign) != 0 ? ~bits : bits | sign;
}

}  // namespace

// Colours from the top down, the ground last.
void ContactSolver::order(const Vec3& gravity, std::span<const ContactConstraint> contacts,
                          int threads) {
  const auto mover = [&](std::int32_t body) {
    const std::int32_t row = rows_.row(body);
    return rows_.moves(row) ? row : -1;
  };
  depth_.clear();
  for (std::size_t k = 0; k < contacts.size(); ++k) {
    const ContactConstraint& c = contacts[k];
    if (c.count == 0 || (mover(c.a) < 0 && mover(c.b) < 0)) continue;
    const auto depth = static_cast<float>(gravity.dot(c.points[0].position));
    depth_.push_back({sort_key(depth), static_cast<std::int32_t>(k)});
  }
  sort_(depth_, 32, threads);
  pairs_.clear();
  for (const auto& entry : depth_) {
    const ContactConstraint& c = contacts[usize(entry.index)];
    pairs_.push_back({mover(c.a), mover(c.b)});
  }
  colours_.assign(pairs_.size(), GraphColouring::kNoColour);
  const auto n = static_cast<std::int32_t>(rows_.size());
  colouring_.colour(pairs_, n, colours_);
  colouring_.make_sweep(pairs_, n, colours_, kPacketLanes, sweep_);
  place_.assign(contacts.size(), -1);
  for (std::size_t k = 0; k < sweep_.constraint.size(); ++k) {
    auto& c = sweep_.constraint[k];
    if (c < 0) continue;
    c = depth_[usize(c)].index;
    place_[usize(c)] = static_cast<std::int32_t>(k);
  }
}

// From the bottom up.
void ContactSolver::mark_standing(std::span<const ContactConstraint> contacts) {
  for (auto it = depth_.rbegin(); it != depth_.rend(); ++it) {
    const ContactConstraint& c = contacts[usize(it->index)];
    const std::int32_t a = rows_.row(c.a), b = rows_.row(c.b);
    auto &stands_a = rows_.stands[usize(a)], &stands_b = rows_.stands[usize(b)];
    if (stands_a == stands_b || !holds(c)) continue;
    if (rows_.moves(a)) stands_a = 1;
    if (rows_.moves(b)) stands_b = 1;
  }
}

void ContactSolver::pack(std::span<const ContactConstraint> contacts, int threads) {
  packets_.reset(usize(sweep_.packets()));
  given_.reset(usize(sweep_.packets()));
  parallel_for(
      sweep_.packets(), kPackets,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t k = begin; k < end; ++k) {
          ContactPacket& packet = packets_[usize(k)];
          for (int lane = 0; lane < kPacketLanes; ++lane) {
            const auto c = sweep_.constraint[usize(k * kPacketLanes + lane)];
            packet.set(lane, c < 0 ? nullptr : &contacts[usize(c)], rows_);
          }
          packet.prepare(rows_);
          given_[usize(k)] = {};
        }
      },
      threads);
}

void ContactSolver::Given::add(const ContactPacket& packet) {
  for (int k = 0; k < 4; ++k) normal[k] = normal[k] + packet.impulse[k];
  for (int i = 0; i < 2; ++i) friction[i] = friction[i] + packet.slide_impulse[i];
}

void ContactSolver::Given::report(int lane, ContactConstraint& contact) const {
  for (int k = 0; k < contact.count; ++k) contact.points[k].total = normal[k][lane];
  for (int i = 0; i < 2; ++i) contact.friction_total[i] = friction[i][lane];
}

// Contacts in flight are none of this sub-step.
void ContactSolver::bounce(double h, double slop) {
  impacts_.advance(rows_, h, slop);
  for (std::int64_t k = 0; k < impacts_.count(); ++k) {
    const auto place = place_[usize(impacts_.contact(k))];
    packets_[usize(place / kPacketLanes)].away[place % kPacketLanes] =
        impacts_.flying(k) ? kFarAway : 0;
  }
}

std::int64_t ContactSolver::step(Bodies& bodies, const Vec3& gravity, double dt,
                                 std::span<ContactConstraint> contacts,
                                 const ContactOptions& options,
                                 std::span<const std::uint8_t> asleep, std::span<Joint> joints,
                                 int threads) {
  const double h = dt / options.substeps;
  const ContactPacket::Settings settings{1 / h, options.correction, options.slop,
                                         options.push_speed * h};
  rows_.load(bodies, gravity, asleep, threads);
  // Contacts may turn a light body far in a sub-step: joints take back as much as they can in a
  // step.
  joints_.begin_step(bodies, joints, contacts, {h, options.push_speed * dt, options.rotation},
                     rows_);
  order(gravity, contacts, threads);
  mark_standing(contacts);
  pack(contacts, threads);
  impacts_.begin_step(contacts, rows_);

  const double slow = 0.5 * h * gravity.norm();
  const double lost = std::min(1.0, h * options.settling);

  const auto packet = [&](std::int64_t k) -> ContactPacket& { return packets_[usize(k)]; };
  Phases phases(64);
  const auto add_joints = [&](const auto& task) {
    if (joints_.groups() > 0) {
      phases.add(joints_.groups(), [this, task](std::int64_t k) { task(joints_.group(k)); });
    }
  };
  phases.add_sweep(sweep_, [&](std::int64_t k) { packet(k).warm_start(rows_); });
  for (int substep = 0; substep < options.substeps; ++substep) {
    if (!impacts_.empty()) phases.add(1, [&](std::int64_t) { bounce(h, options.slop); });
    phases.add_range(rows_.size(), kBodies, [&](std::int64_t begin, std::int64_t end) {
      rows_.accelerate(begin, end, h, slow, lost);
    });
    for (int sweep = 0; sweep < options.sweeps; ++sweep) {
      add_joints([&, sweep](JointGroup& group) { group.solve_velocities(rows_, sweep == 0); });
      phases.add_sweep(sweep_, [&, sweep](std::int64_t k) {
        if (sweep == 0) packet(k).solve_positions(rows_, settings);
        packet(k).solve_velocities(rows_);
        if (sweep + 1 == options.sweeps) given_[usize(k)].add(packet(k));
      });
    }
    phases.add_range(rows_.size(), kBodies,
                     [&](std::int64_t begin, std::int64_t end) { rows_.move(begin, end, h); });
    add_joints([&](JointGroup& group) { group.move(rows_); });
    add_joints([&](JointGroup& group) { group.solve_positions(rows_); });
  }
  add_joints([&](JointGroup& group) { group.end_step(rows_); });
  phases.run(threads);

  const std::int64_t bad = rows_.store(bodies, dt, options.rotation, threads);
  if (bad >= 0) return bad;
  for (std::size_t c = 0; c < contacts.size(); ++c) {
    if (place_[c] < 0) continue;
    const std::int64_t k = place_[c] / kPacketLanes;
    packet(k).get(place_[c] % kPacketLanes, contacts[c]);
    given_[usize(k)].report(place_[c] % kPacketLanes, contacts[c]);
  }
  impacts_.report(contacts);
  joints_.store(bodies, joints, dt);
  return -1;
}

}  // namespace substep::rigid
