#include "substep/rigid/solver/contact_solver.h"

#include <algorithm>
#include <bit>
#include <new>
#include <type_traits>

#include "substep/core/parallel.h"
#include "substep/core/prefetch.h"
#include "substep/core/usize.h"
#include "substep/rigid/solver/stick_slip.h"

namespace substep::rigid {
namespace {

constexpr int kPacketLanes = ContactPacket::kLanes;
constexpr std::int64_t kBodies = 512;  // per chunk
constexpr std::int64_t kPackets = 16;  // per chunk, where they are independent
constexpr std::int64_t kRows = 32;     // that stay in the cache while they are passed over twice
constexpr std::size_t kAhead = 4;      // contacts that are asked for before they are needed
// Of what rolls on: the least turn in a step that counts and the turn in a sub-step that no
// geometry follows [rad], the most that u changes in half a sub-step unless another corner touches,
// and how many others it touches.
constexpr double kRolls = 1e-4, kFar = 0.5, kSmooth = 0.2;
constexpr int kFew = 2;
// Sweeps over light bodies that a heavy load, at their joints or on them, presses on something.
constexpr int kStrainedSweeps = 16;
// One body lies on another where the normal is within 60 degrees of gravity, and is much heavier
// from this ratio of masses on.
constexpr double kLies = 0.5, kHeavier = 16;

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
    tasks_.emplace_back(task);
  }
  template <class F>
  void add_range(std::int64_t n, std::int64_t grain, const F& task) {
    add((n + grain - 1) / grain,
        [=](std::int64_t chunk) { task(chunk * grain, std::min(n, (chunk + 1) * grain)); });
  }
  // Of each colour the packets, colour after colour. Colours of one chunk each follow one another
  // in one task.
  template <class F>
  void add_sweep(const Sweep& sweep, const F& packet) {
    const std::size_t colours = sweep.chunks_of_phase.size();
    for (std::size_t f = 0, end; f < colours; f = end) {
      end = f + 1;
      const bool single = sweep.chunks_of_phase[f] == 1;
      while (single && end < colours && sweep.chunks_of_phase[end] == 1) ++end;
      const auto first = usize(sweep.phase_start[f]), each = single ? end - f : 1;
      add(sweep.chunks_of_phase[f], [&sweep, first, each, packet](std::int64_t chunk) {
        const auto c = first + usize(chunk);
        for (auto k = sweep.chunk_start[c]; k < sweep.chunk_start[c + each]; ++k) packet(k);
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

void sort_unique(std::vector<std::int64_t>& packets) {
  std::sort(packets.begin(), packets.end());
  packets.erase(std::unique(packets.begin(), packets.end()), packets.end());
}

// Which body of a contact the other one lies on: -1 for a, 1 for b, 0 for none.
int lower_side(const Vec3& normal, const Vec3& gravity) {
  const double along = normal.dot(gravity), least = kLies * gravity.norm();
  return along < -least ? -1 : along > least ? 1 : 0;
}

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

void ContactSolver::mark_jointed(std::span<const Joint> joints) {
  jointed_.assign(usize(rows_.size()), 0);
  for (const Joint& joint : joints) {
    jointed_[usize(rows_.row(joint.a))] = 1;
    jointed_[usize(rows_.row(joint.b))] = 1;
  }
  jointed_[0] = 0;  // the world
}

void ContactSolver::ask_for_contact(std::size_t place,
                                    std::span<const ContactConstraint> contacts) const {
  if (place >= sweep_.constraint.size()) return;
  if (const auto c = sweep_.constraint[place]; c >= 0) prefetch(contacts[usize(c)]);
}

// Motors and springs of joints press in any direction, gravity only along itself.
void ContactSolver::pack(std::span<const ContactConstraint> contacts, const Vec3& fall,
                         int threads) {
  packets_.reset(usize(sweep_.packets()));
  given_.reset(usize(sweep_.packets()));
  hit_.assign(usize(sweep_.packets()), 0);
  uneven_.assign(usize(sweep_.packets()), 0);
  parallel_for(
      sweep_.packets(), kPackets,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t k = begin; k < end; ++k) {
          ContactPacket& packet = packets_[usize(k)];
          Given& given = given_[usize(k)];
          given = Given();
          const ContactConstraint* of[kPacketLanes];
          bool all[kPacketLanes];
          for (int lane = 0; lane < kPacketLanes; ++lane) {
            const auto place = usize(k * kPacketLanes + lane);
            ask_for_contact(place + kAhead, contacts);
            const auto c = sweep_.constraint[place];
            of[lane] = c < 0 ? nullptr : &contacts[usize(c)];
            all[lane] = true;
          }
          packet.set(of, all, rows_);
          for (int lane = 0; lane < kPacketLanes; ++lane) {
            if (of[lane] == nullptr) continue;
            given.load[lane] = of[lane]->load;
            const bool driven = (packet.moves_a[lane] && jointed_[usize(packet.a[lane])] != 0) ||
                                (packet.moves_b[lane] && jointed_[usize(packet.b[lane])] != 0);
            const double fast = driven ? fall.norm() : std::abs(of[lane]->normal.dot(fall));
            given.jump[lane] = impact_start_.jump(packet.a[lane], packet.b[lane], fast);
            given.growth[lane] = impact_start_.growth(packet.a[lane], packet.b[lane], fast);
          }
          packet.prepare(rows_);
          packet.bears_a = packet.bears_b = 0;
          uneven_[usize(k)] = packet.is_uneven(kHeavier);
          hit_[usize(k)] = ImpactStart::is_hit(packet, given.load);
        }
      },
      threads);
}

// From the bottom up: bodies that lie with at least three points on what is borne, or moves by no
// impulse.
void ContactSolver::mark_borne(std::span<const ContactConstraint> contacts, const Vec3& gravity) {
  borne_.resize(usize(rows_.size()));
  for (std::int32_t row = 0; row < rows_.size(); ++row)
    borne_[usize(row)] = rows_.moves(row) ? 0 : 1;
  for (auto it = depth_.rbegin(); it != depth_.rend(); ++it) {
    const ContactConstraint& c = contacts[usize(it->index)];
    if (c.count < 3) continue;
    auto &a = borne_[usize(rows_.row(c.a))], &b = borne_[usize(rows_.row(c.b))];
    const int side = lower_side(c.normal, gravity);
    if (side < 0) b |= a;
    if (side > 0) a |= b;
  }
}

// What is borne bears what is much heavier.
void ContactSolver::note_bearers(const Vec3& gravity, ContactPacket& p) const {
  for (int lane = 0; lane < kPacketLanes; ++lane) {
    if (!p.moves_a[lane] || !p.moves_b[lane]) continue;
    const std::int32_t a = p.a[lane], b = p.b[lane];
    const Vec3 normal(p.normal[0][lane], p.normal[1][lane], p.normal[2][lane]);
    const int side = lower_side(normal, gravity);
    const double root = rows_.scale_of(a) / rows_.scale_of(b), ratio = root * root;
    const bool is_a = side < 0 && borne_[usize(a)] != 0 && ratio > kHeavier;
    const bool is_b = side > 0 && borne_[usize(b)] != 0 && ratio * kHeavier < 1;
    p.bears_a |= static_cast<std::uint8_t>(is_a << lane);
    p.bears_b |= static_cast<std::uint8_t>(is_b << lane);
  }
}

void ContactSolver::find_bearers(std::span<const ContactConstraint> contacts, const Vec3& gravity) {
  if (std::find(uneven_.begin(), uneven_.end(), 1) == uneven_.end()) return;
  mark_borne(contacts, gravity);
  for (std::size_t k = 0; k < uneven_.size(); ++k)
    if (uneven_[k] != 0) note_bearers(gravity, packets_[k]);
}

bool ContactSolver::find_strained(std::span<const ContactConstraint> contacts,
                                  std::int64_t bodies) {
  straining_.assign(usize(bodies), 0);
  joints_.mark_whirling(straining_);
  const auto mark_bearer = [this](std::uint8_t bears, int lane, std::int32_t row) {
    if ((bears >> lane & 1) != 0) straining_[usize(rows_.body_of[usize(row)])] = 1;
  };
  for (std::size_t k = 0; k < uneven_.size(); ++k) {
    const ContactPacket& packet = packets_[k];
    for (int lane = 0; uneven_[k] != 0 && lane < kPacketLanes; ++lane) {
      mark_bearer(packet.bears_a, lane, packet.a[lane]);
      mark_bearer(packet.bears_b, lane, packet.b[lane]);
    }
  }
  strained_.assign(usize(sweep_.packets()), 0);
  if (std::find(straining_.begin(), straining_.end(), 1) == straining_.end()) return false;
  bool any = false;
  for (std::size_t k = 0; k < contacts.size(); ++k) {
    const ContactConstraint& c = contacts[k];
    if (place_[k] < 0 || (straining_[usize(c.a)] == 0 && straining_[usize(c.b)] == 0)) continue;
    strained_[usize(place_[k] / kPacketLanes)] = 1;
    any = true;
  }
  return any;
}

void ContactSolver::Given::add(const ContactPacket& packet) {
  for (int k = 0; k < 4; ++k) normal[k] = normal[k] + packet.impulse[k];
  for (int i = 0; i < 2; ++i) friction[i] = friction[i] + packet.slide_impulse[i];
}

void ContactSolver::Given::report(int lane, ContactConstraint& contact) const {
  for (auto& point : contact.points) point.total = 0;
  for (int k = 0; k < 4; ++k) contact.last_of(k).total += normal[k][lane];
  for (int i = 0; i < 2; ++i) contact.friction_total[i] = friction[i][lane];
  contact.load = load[lane];
}

// Contacts in flight are none of this sub-step.
void ContactSolver::bounce(double h, double slop) {
  impacts_.advance(rows_, h, slop);
  for (std::int64_t k = 0; k < impacts_.count(); ++k) {
    const auto place = place_[usize(impacts_.contact(k))];
    packets_[usize(place / kPacketLanes)].away[place % kPacketLanes] =
        impacts_.flying(k) ? ContactPacket::kFarAway : 0;
  }
}

void ContactSolver::start_impacts() {
  if (std::find(hit_.begin(), hit_.end(), 1) == hit_.end()) return;
  const auto each = [&](const auto& task) {
    for (std::size_t k = 0; k < hit_.size(); ++k)
      if (hit_[k] != 0) task(packets_[k], given_[k].load);
  };
  impact_start_.begin(true);
  each([&](const ContactPacket& packet, const auto& load) {
    impact_start_.add(packet, load, rows_);
  });
  impact_start_.withdraw(rows_);
  each([&](ContactPacket& packet, const auto& load) {
    packet.scale_impulses(impact_start_.left(packet, load));
  });
}

// Loads end between steps.
void ContactSolver::end_loads(double h, double fast) {
  const auto bears = [this](std::int64_t k, int lane) {
    const ContactPacket& packet = packets_[usize(k)];
    return packet.pressure()[lane] > 0 &&
           !(hit_[usize(k)] != 0 && impact_start_.goes_on(packet, given_[usize(k)].load, lane));
  };
  const auto parts =
      load_ends_.find(rows_, {packets_.begin(), packets_.end()}, bears, jointed_, h, fast);
  if (parts.empty()) return;
  impact_start_.begin(false);
  for (const auto& p : parts) impact_start_.add(packets_[usize(p.packet)], p.lane, p.part, rows_);
  impact_start_.withdraw(rows_);
  for (const auto& p : parts) {
    ContactPacket& packet = packets_[usize(p.packet)];
    packet.scale_impulses(p.lane, impact_start_.left(packet, p.lane, p.part));
  }
}

// A contact of round shapes rolls on if a body of it that touches few others turns, or goes along
// the other; one that many others touch is held by them. Those bodies turn with their sub-steps,
// but for jointed ones, whose joints see to their rotation; and all contacts of what turns go with
// it.
void ContactSolver::find_rolling(std::span<ContactConstraint> contacts, double dt, double h,
                                 double slop) {
  rolling_.assign(contacts.size(), 0);
  turning_.clear();
  rolling_packets_.clear();
  renewed_.assign(usize(sweep_.packets()), 0);
  const auto may_roll = [](const ContactConstraint& c) { return c.rolls_on || c.tips; };
  if (!touch_ || std::none_of(contacts.begin(), contacts.end(), may_roll)) return;
  touched_.assign(usize(rows_.size()), 0);
  for (std::size_t k = 0; k < contacts.size(); ++k) {
    const ContactConstraint& c = contacts[k];
    const bool again = k > 0 && contacts[k - 1].a == c.a && contacts[k - 1].b == c.b;
    if (place_[k] < 0 || again) continue;
    ++touched_[usize(rows_.row(c.a))];
    ++touched_[usize(rows_.row(c.b))];
  }
  const auto is_free = [&](std::int32_t row) {
    return rows_.moves(row) && touched_[usize(row)] <= kFew;
  };
  std::vector<std::uint8_t>& turns = rows_.turns;
  bool any = false;
  for (std::size_t k = 0; k < contacts.size(); ++k) {
    ContactConstraint& c = contacts[k];
    const std::int32_t a = rows_.row(c.a), b = rows_.row(c.b);
    c.rolls_on |= c.tips && jointed_[usize(a)] == 0 && jointed_[usize(b)] == 0;
    if (place_[k] < 0 || !c.rolls_on) continue;
    if (!is_free(a) && !is_free(b)) continue;
    const Vec3 v_a = rows_.velocity_of(a), v_b = rows_.velocity_of(b);
    const Vec3 w_a = rows_.spin_of(a), w_b = rows_.spin_of(b);
    const double rate_a = w_a.norm(), rate_b = w_b.norm();
    if (!(h * rate_a < kFar && h * rate_b < kFar)) continue;
    const double size_a = c.points[0].arm_a.norm(), size_b = c.points[0].arm_b.norm();
    const double speed = std::max({rate_a * size_a, rate_b * size_b, (v_a - v_b).norm()});
    if (!(dt * speed > kRolls * std::min(size_a, size_b))) continue;
    any = true;
    rolling_[k] = 1;
    for (const std::int32_t row : {a, b})
      if (is_free(row) || !rows_.moves(row)) turns[usize(row)] = 1;
  }
  if (!any) return;
  turns[0] = 0;
  for (std::size_t r = 0; r < turns.size(); ++r) {
    if (jointed_[r] != 0) turns[r] = 0;
    if (turns[r] != 0) turning_.push_back(static_cast<std::int32_t>(r));
  }
  for (std::size_t k = 0; k < contacts.size(); ++k) {
    if (place_[k] < 0) continue;
    ContactConstraint& c = contacts[k];
    const std::int32_t a = rows_.row(c.a), b = rows_.row(c.b);
    if (turns[usize(a)] != 0 || turns[usize(b)] != 0) rolling_[k] = 1;
    if (rolling_[k] == 0) continue;
    // What a sub-step may reach: by the approach, and by tipping about the point.
    const Vec3 &n = c.normal, v = rows_.velocity_of(a) - rows_.velocity_of(b);
    c.margin = 2 * slop + 2 * h *
                              (std::abs(n.dot(v)) +
                               rows_.spin_of(a).norm() * c.points[0].arm_a.cross(n).norm() +
                               rows_.spin_of(b).norm() * c.points[0].arm_b.cross(n).norm());
    rolling_packets_.push_back(place_[k] / kPacketLanes);
  }
  sort_unique(rolling_packets_);
  for (const std::int64_t k : rolling_packets_)
    renewed_[usize(k)] = 1, packets_[usize(k)].rolls_on = true;
}

// Of the contacts that are found anew those of spheres and capsules, where joints rule how bodies
// turn. Contacts that need more of their geometry in a sub-step are none: what bounces, what may
// begin to slip.
void ContactSolver::find_round(std::span<const ContactConstraint> contacts, const Bodies& bodies,
                               const Round& round) {
  round_.assign(usize(sweep_.packets()), -1);
  rounds_.reset(round ? rolling_packets_.size() : 0);
  if (!round || rolling_packets_.empty()) return;
  bounces_.assign(contacts.size(), 0);
  for (std::int64_t k = 0; k < impacts_.count(); ++k) bounces_[usize(impacts_.contact(k))] = 1;
  std::int32_t count = 0;
  for (const std::int64_t packet : rolling_packets_) {
    RoundContacts& contacts_of = rounds_[usize(count)];
    for (int lane = 0; lane < kPacketLanes; ++lane) {
      if (!is_rolling(packet, lane)) continue;
      const auto index = usize(sweep_.constraint[usize(packet * kPacketLanes + lane)]);
      const ContactConstraint& c = contacts[index];
      const auto a = usize(rows_.row(c.a)), b = usize(rows_.row(c.b));
      if (!c.rolls_on || bounces_[index] != 0 || sticks_more(c)) continue;
      if ((jointed_[a] == 0 && jointed_[b] == 0) || rows_.turns[a] != 0 || rows_.turns[b] != 0)
        continue;
      const std::optional<RoundPair> pair = round(c);
      if (!pair) continue;
      if (round_[usize(packet)] < 0) contacts_of.clear();
      round_[usize(packet)] = count;
      contacts_of.add(lane, *pair, c, bodies);
    }
    if (round_[usize(packet)] >= 0) ++count;
  }
}

RoundContacts* ContactSolver::round_of(std::int64_t packet) {
  const std::int32_t k = round_[usize(packet)];
  return k < 0 ? nullptr : &rounds_[usize(k)];
}

// Contacts with two coefficients of friction, which choose between them after each sub-step.
void ContactSolver::find_slipping(std::span<ContactConstraint> contacts, double fast) {
  slip_packets_.clear();
  for (std::size_t k = 0; k < contacts.size(); ++k) {
    ContactConstraint& c = contacts[k];
    if (place_[k] < 0 || !sticks_more(c)) continue;
    slip_packets_.push_back(place_[k] / kPacketLanes);
    const bool presses = std::any_of(c.points, c.points + c.count,
                                     [](const auto& point) { return point.impulse > 0; });
    if (!presses) begin_slip(rows_, fast, c);
  }
  sort_unique(slip_packets_);
}

void ContactSolver::note_slips(std::int64_t packet, std::span<ContactConstraint> contacts,
                               double fast) {
  ContactPacket& p = packets_[usize(packet)];
  for (int lane = 0; lane < kPacketLanes; ++lane) {
    const auto index = sweep_.constraint[usize(packet * kPacketLanes + lane)];
    if (index < 0 || !sticks_more(contacts[usize(index)])) continue;
    ContactConstraint& c = contacts[usize(index)];
    note_slip(p, lane, rows_, fast, c);
    p.friction[lane] = static_cast<float>(c.mu());
  }
}

bool ContactSolver::is_rolling(std::int64_t packet, int lane) const {
  const auto c = sweep_.constraint[usize(packet * kPacketLanes + lane)];
  return c >= 0 && rolling_[usize(c)] != 0;
}

// What does not roll on keeps its points.
void ContactSolver::note_separations(std::int64_t packet, std::span<ContactConstraint> contacts) {
  const RoundContacts* round = round_of(packet);
  bool noted[kPacketLanes];
  for (int lane = 0; lane < kPacketLanes; ++lane)
    noted[lane] = is_rolling(packet, lane) && !(round != nullptr && round->has(lane));
  if (std::find(noted, noted + kPacketLanes, true) == noted + kPacketLanes) return;
  ContactPacket::V C[4];
  packets_[usize(packet)].find_separations(rows_, C);
  for (int lane = 0; lane < kPacketLanes; ++lane) {
    if (!noted[lane]) continue;
    ContactConstraint& c = contacts[usize(sweep_.constraint[usize(packet * kPacketLanes + lane)])];
    for (int k = 0; k < c.count; ++k) c.points[k].separation = C[k][lane];
  }
}

// Only points that press or that this sub-step may reach act: friction is at their middle.
void ContactSolver::drop_distant_points(ContactConstraint& c, double h) const {
  const std::int32_t a = rows_.row(c.a), b = rows_.row(c.b);
  const Vec3 v = rows_.velocity_of(b) - rows_.velocity_of(a);
  const Vec3 w_a = rows_.spin_of(a), w_b = rows_.spin_of(b);
  const auto reaches = [&](const ContactConstraint::Point& p) {
    return p.separation + h * c.normal.dot(v + w_b.cross(p.arm_b) - w_a.cross(p.arm_a));
  };
  const auto nearest = std::min_element(c.points, c.points + c.count, [](auto& p, auto& q) {
                         return p.separation < q.separation;
                       })->separation;
  const auto end = std::remove_if(c.points, c.points + c.count, [&](const auto& p) {
    return p.impulse == 0 && p.separation > nearest + kReached &&
           reaches(p) > std::max(nearest, 0.0);
  });
  c.count = static_cast<int>(end - c.points);
}

bool ContactSolver::find_anew(const Pose& a, const Pose& b, double h, ContactConstraint& c) const {
  const ContactConstraint last = c;
  if (!touch_(a, b, c)) return false;
  carry_impulses(last, c);
  drop_distant_points(c, h);
  return true;
}

void ContactSolver::renew(std::int64_t packet, std::span<ContactConstraint> contacts,
                          const Bodies& bodies, double h) {
  ContactPacket& p = packets_[usize(packet)];
  RoundContacts* const round = round_of(packet);
  if (round != nullptr) round->find(rows_, h, p);
  bool rolling[kPacketLanes], one_by_one[kPacketLanes];
  const ContactConstraint* found[kPacketLanes] = {};
  Pose now_a[kPacketLanes], now_b[kPacketLanes];
  for (int lane = 0; lane < kPacketLanes; ++lane) {
    rolling[lane] = is_rolling(packet, lane);
    one_by_one[lane] = rolling[lane] && !(round != nullptr && round->has(lane));
    if (!one_by_one[lane]) continue;
    ContactConstraint& c = contacts[usize(sweep_.constraint[usize(packet * kPacketLanes + lane)])];
    p.get(lane, c);
    if (round != nullptr && round->left(lane)) round->report(lane, p, c);
    if (c.rolls_on) {
      now_a[lane] = rows_.pose(bodies, c.a), now_b[lane] = rows_.pose(bodies, c.b);
      find_anew(now_a[lane], now_b[lane], h, c);
    }
    found[lane] = &c;
  }
  p.set(found, one_by_one, rows_);
  p.prepare(rows_);
  p.rebase(rows_, rolling);
  p.rolls_on = true;
  for (int lane = 0; lane < kPacketLanes; ++lane) {
    if (!one_by_one[lane]) continue;
    const auto& c = contacts[usize(sweep_.constraint[usize(packet * kPacketLanes + lane)])];
    if (c.rolls_on) set_bias(packet, lane, c, bodies, now_a[lane], now_b[lane], h);
  }
}

// Half of what J, not v, will change of J v until the end of the sub-step; nothing for what meets,
// where another corner will touch instead, or where a joint rules how bodies turn.
void ContactSolver::set_bias(std::int64_t packet, int lane, const ContactConstraint& contact,
                             const Bodies& bodies, const Pose& now_a, const Pose& now_b, double h) {
  const std::int32_t a = rows_.row(contact.a), b = rows_.row(contact.b);
  if (jointed_[usize(a)] != 0 || jointed_[usize(b)] != 0) return;
  const Vec3 v = rows_.velocity_of(b) - rows_.velocity_of(a);
  const auto seen = [&](const ContactConstraint& c, const Vec3& w_a, const Vec3& w_b) {
    const Vec3 u = v + w_b.cross(c.middle(&ContactConstraint::Point::arm_b)) -
                   w_a.cross(c.middle(&ContactConstraint::Point::arm_a));
    return Vec3(u.dot(c.tangent), u.dot(c.normal.cross(c.tangent)), u.dot(c.normal));
  };
  ContactConstraint then = contact;
  Vec3 w_a, w_b;
  const Pose pose_a = rows_.pose_after(bodies, contact.a, now_a, h, w_a),
             pose_b = rows_.pose_after(bodies, contact.b, now_b, h, w_b);
  if (!find_anew(pose_a, pose_b, h, then) || then.count != contact.count) return;
  const Vec3 u = seen(contact, rows_.spin_of(a), rows_.spin_of(b));
  const Vec3 bias = 0.5 * (seen(then, w_a, w_b) - u);
  const auto speed = [&](std::int32_t row, Vec3 ContactConstraint::Point::* arm) {
    return rows_.velocity_of(row).norm() + rows_.spin_of(row).norm() * contact.middle(arm).norm();
  };
  const double smooth = kSmooth * (speed(a, &ContactConstraint::Point::arm_a) +
                                   speed(b, &ContactConstraint::Point::arm_b));
  if (!(bias.norm() < smooth)) return;
  for (int i = 0; i < 3; ++i) packets_[usize(packet)].bias[i][lane] = static_cast<float>(bias[i]);
}

std::int64_t ContactSolver::step(Bodies& bodies, const Vec3& gravity, double dt,
                                 std::span<ContactConstraint> contacts,
                                 const ContactOptions& options,
                                 std::span<const std::uint8_t> asleep, std::span<Joint> joints,
                                 int threads, const Touch& touch, const Round& round) {
  const double h = dt / options.substeps;
  touch_ = touch;
  const ContactPacket::Settings settings{1 / h, options.correction, options.slop,
                                         options.push_speed * h};
  rows_.load(bodies, gravity, asleep, threads);
  // Contacts may turn a light body far in a sub-step: joints take back as much as they can in a
  // step.
  impact_start_.begin_step(joints, rows_);
  joints_.begin_step(bodies, joints, contacts, {dt, h, options.push_speed * dt, options.rotation},
                     rows_);
  const double fast = h * gravity.norm();
  order(gravity, contacts, threads);
  find_slipping(contacts, fast);
  mark_standing(contacts);
  mark_jointed(joints);
  pack(contacts, h * gravity, threads);
  find_bearers(contacts, gravity);
  const bool strained = find_strained(contacts, bodies.size());
  find_rolling(contacts, dt, h, options.slop);
  impacts_.begin_step(contacts, rolling_, h, rows_, [&](ContactConstraint& c, double time) {
    Vec3 spin;
    const auto after = [&](std::int32_t body) {
      return rows_.pose_after(bodies, body, rows_.pose(bodies, body), time, spin);
    };
    const Pose a = after(c.a), b = after(c.b);
    return touch_(a, b, c);
  });
  find_round(contacts, bodies, round);

  const double slow = 0.5 * h * gravity.norm();
  const double lost = std::min(1.0, h * options.settling);

  const auto packet = [&](std::int64_t k) -> ContactPacket& { return packets_[usize(k)]; };
  const auto sweeps_of = [&](bool strains) { return strains ? kStrainedSweeps : options.sweeps; };
  Phases phases(512);
  const auto add_joints = [&](const auto& task) {
    if (joints_.groups() > 0) {
      phases.add(joints_.groups(), [this, task](std::int64_t k) { task(joints_.group(k)); });
    }
  };
  const auto add_each = [&](const std::vector<std::int64_t>& packets, const auto& task) {
    phases.add_range(static_cast<std::int64_t>(packets.size()), kPackets,
                     [&packets, task](std::int64_t begin, std::int64_t end) {
                       for (auto i = usize(begin); i < usize(end); ++i) task(packets[i]);
                     });
  };
  const bool rolls = !rolling_packets_.empty();
  // Nothing comes between the end of a sub-step and the beginning of the next.
  const bool at_once = !rolls && impacts_.empty() && joints_.groups() == 0;
  const auto accelerate = [&](std::int64_t begin, std::int64_t end) {
    rows_.accelerate(begin, end, h, slow, lost);
  };
  for (int substep = 0; substep < options.substeps; ++substep) {
    if (substep == 0 || rolls) {
      phases.add_sweep(sweep_, [&, substep](std::int64_t k) {
        if (renewed_[usize(k)] != 0) {
          if (substep > 0) packet(k).withdraw_push(rows_);
          renew(k, contacts, bodies, h);
        }
        if (substep == 0 || renewed_[usize(k)] != 0) packet(k).warm_start(rows_);
      });
    }
    if (!impacts_.empty())
      phases.add(1, [&](std::int64_t) {
        impacts_.renew(contacts, rows_);
        bounce(h, options.slop);
      });
    if (substep == 0 || !at_once) phases.add_range(rows_.size(), kBodies, accelerate);
    phases.add(1, [&, substep](std::int64_t) {
      start_impacts();
      if (substep == 0) end_loads(h, fast);
    });
    for (int sweep = 0; sweep < sweeps_of(strained); ++sweep) {
      add_joints([&, sweep](JointSolver::Group& group) {
        const int sweeps = sweeps_of(strained && group.whirls());
        if (sweep < sweeps) group.solve_velocities(rows_, sweep == 0, sweep + 1 == sweeps);
      });
      phases.add_sweep(sweep_, [&, sweep](std::int64_t k) {
        const int sweeps = sweeps_of(strained_[usize(k)] != 0);
        if (sweep >= sweeps) return;
        if (sweep == 0) packet(k).solve_positions(rows_, settings);
        Given& given = given_[usize(k)];
        const auto most = 1.2 * packet(k).pressure() + 4 * given.jump;
        packet(k).solve_velocities(rows_);
        if (sweep == 0 && !packet(k).few && ImpactStart::is_hit(packet(k), most))
          packet(k).solve_impact(rows_);
        if (sweep + 1 < sweeps) return;
        given.add(packet(k));
        ImpactStart::grow(packet(k), given.jump, given.growth, given.load);
        hit_[usize(k)] = ImpactStart::is_hit(packet(k), given.load);
      });
    }
    if (!slip_packets_.empty())
      add_each(slip_packets_, [&](std::int64_t k) { note_slips(k, contacts, fast); });
    const bool goes_on = at_once && substep + 1 < options.substeps;
    phases.add_range(rows_.size(), kBodies, [&, goes_on](std::int64_t begin, std::int64_t end) {
      for (std::int64_t next; begin < end; begin = next) {
        next = std::min(end, begin + kRows);
        rows_.move(begin, next, h);
        if (goes_on) accelerate(begin, next);
      }
    });
    add_joints([&](JointSolver::Group& group) { group.move(rows_); });
    if (!rolls) continue;
    add_each(rolling_packets_, [&](std::int64_t k) { note_separations(k, contacts); });
    phases.add_range(static_cast<std::int64_t>(turning_.size()), kBodies,
                     [&](std::int64_t begin, std::int64_t end) {
                       for (auto i = usize(begin); i < usize(end); ++i)
                         rows_.turn(bodies, turning_[i], h, options.rotation);
                     });
  }
  add_joints([&](JointSolver::Group& group) { group.end_step(rows_); });
  phases.run(threads);
  touch_ = nullptr;

  const std::int64_t bad = rows_.store(bodies, dt, options.rotation, threads);
  if (bad >= 0) return bad;
  for (const std::int64_t k : rolling_packets_)
    if (RoundContacts* const found = round_of(k)) found->finish(rows_, packet(k));
  parallel_for(
      sweep_.packets(), kPackets,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t k = begin; k < end; ++k) {
          const RoundContacts* const found = round_of(k);
          for (int lane = 0; lane < kPacketLanes; ++lane) {
            const auto place = usize(k * kPacketLanes + lane);
            ask_for_contact(place + kAhead, contacts);
            if (sweep_.constraint[place] < 0) continue;
            ContactConstraint& c = contacts[usize(sweep_.constraint[place])];
            packet(k).get(lane, c);
            if (found != nullptr && found->has(lane)) found->report(lane, packet(k), c);
            given_[usize(k)].report(lane, c);
          }
        }
      },
      threads);
  impacts_.report(contacts);
  joints_.store(bodies, joints, dt);
  return -1;
}

}  // namespace substep::rigid
