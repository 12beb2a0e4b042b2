// A world of rigid bodies: what a step does, and what holds from step to step.
//
// Bodies have numbers in the order in which they were added, and so have their fixtures; what is
// removed makes those behind it move up. State of a body: bodies.h. Contact, friction, restitution:
// contact_constraint.h, contact_solver.h; fast bodies: contact_finder.h, fast_bodies.h.
//
// Surfaces of a pair: friction sqrt(f_a f_b), static friction by the same rule, restitution,
// rolling and spinning levers the greater of both; but what a pair of materials says holds instead.
//
// Islands of bodies that touch fall asleep when for some time none of them has moved by more than a
// small distance: a mean over that time, so that what only begins to slide is told from what shakes
// in its place. They are static then, and wake as islands.h says. Bodies of a mere push, or of a
// pose that was written, wake as well.
//
// What a step computes depends on what state() holds, on nothing else: not on pairs that come near
// without touching, nor on how the broad phase came to its boxes, nor on threads.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/held.h"
#include "substep/core/usize.h"
#include "substep/rigid/solver/contact_constraint.h"
#include "substep/rigid/solver/contact_options.h"
#include "substep/rigid/solver/islands.h"
#include "substep/rigid/solver/joint.h"
#include "substep/rigid/world/fixtures.h"
#include "substep/rigid/world/world_state.h"

namespace substep::rigid {

class BroadPhase;
class ContactFinder;
class ContactSolver;
struct Scene;  // queries.h

struct WorldOptions {
  struct Sleep {
    double distance = 1e-4;  // [m] that no point of an island moves
    double time = 0.5;       // for this time [s]
  };

  Vec3 gravity{0, 0, -9.81};  // [m/s^2]
  ContactOptions contact;
  double contact_margin = 0.02;  // distance at which contacts begin, or a tenth of the inner radius
                                 // of smaller bodies [m]
  bool sleeping = true;
  Sleep sleep;
  bool continuous = true;  // fast bodies meet others where they would have passed them
};

class World {
 public:
  // InputError: an option is out of range.
  explicit World(const WorldOptions& options = {});
  World(const World& other);
  World(World&& other) noexcept;
  World& operator=(const World& other);
  World& operator=(World&& other) noexcept;
  ~World();

  // The number of the new body. InputError: something is out of range (Bodies::add,
  // check_fixtures); nothing changed then. A body may have no fixture: it touches nothing.
  std::int32_t add(const BodyState& body, std::span<const Fixture> fixtures);
  // The number of the first of several with the same fixtures; what fails changes nothing.
  std::int32_t add(std::span<const BodyState> bodies, std::span<const Fixture> fixtures);
  // So that adding so many bodies with so many fixtures in all takes hardly any more memory, and so
  // fails now or not at all. InputError: they are more than there are numbers.
  void make_room(std::int64_t bodies, std::int64_t fixtures);
  // The new numbers of bodies, -1 for those removed. InputError: no such body. What fails changes
  // nothing; so the world is copied, and bodies are best removed together.
  std::vector<std::int64_t> remove(std::span<const std::int64_t> bodies);
  // Makes the body static, kinematic or dynamic; mass and moments are those of a dynamic one.
  // InputError: they are none, or the body has a plane or a mesh.
  void set_motion(std::int64_t body, Motion motion, double mass = 1,
                  const Vec3& inertia = Vec3::Ones());
  // Bodies that go through each other from now on, or no more.
  void exclude(std::int32_t a, std::int32_t b, bool excluded = true);

  // From the next step on; all bodies wake. InputError, and nothing changed: a number is out of
  // range, or no fixture is of such a material.
  void set_material_pair(const MaterialPair& pair);
  std::span<const MaterialPair> material_pairs() const { return fixtures_.material_pairs().all(); }

  // The number of the new joint; its bodies go through each other unless joint.collide. InputError:
  // see check_joint(); nothing changed then.
  std::int32_t add_joint(const Joint& joint);
  // Another motor, other limits: wakes the bodies. InputError: see check_joint(), or no such joint.
  void set_joint(std::int64_t number, const Joint& joint);
  // Those behind move up. InputError: no such joint; nothing changed then.
  void remove_joints(std::span<const std::int64_t> numbers);
  // With the forces of the last step.
  std::span<const Joint> joints() const { return joints_; }

  // By dt [s]. What fails changes nothing: InputError for dt; NonFiniteError names the body,
  // SolverError the joint that the step would tear apart; std::bad_alloc; what a poll for
  // interrupts throws.
  void step(double dt);

  // Rows may be written between steps. A sleeping body wakes with the next one if its pose or a
  // momentum was written, or a force acts on it.
  Bodies& bodies() { return bodies_; }
  const Bodies& bodies() const { return bodies_; }
  const Fixtures& fixtures() const { return fixtures_; }

  bool asleep(std::int64_t body) const { return asleep_[usize(body)] != 0; }
  void wake(std::int64_t body);  // with its island

  // Of the last step, in the order of the fixtures: those of bodies that are awake, and of others.
  std::span<const ContactConstraint> contacts() const { return contacts_; }
  std::span<const ContactConstraint> sleeping_contacts() const { return sleeping_contacts_; }
  std::int64_t impacts() const;  // with restitution, of the last step

  // For queries, where all bodies are now; valid until something changes.
  Scene scene();

  WorldState state() const;
  // InputError: the parts do not belong together; nothing changed then.
  void restore(const WorldState& state);

  double time = 0;         // [s]
  std::int64_t steps = 0;  // done
  int threads = 0;         // 0: num_threads()
  const WorldOptions& options() const { return options_; }
  // InputError: an option is out of range. The margin is that of bodies which are added later.
  void set_options(const WorldOptions& options);

 private:
  // What a step that fails goes back to.
  struct Before {
    std::vector<double> x, q, P, L, rest_x, rest_q, placed_x, placed_q;
    std::vector<Joint> joints;
    Islands islands;
  };

  void check_body(std::int64_t body) const;
  void check_joint_number(std::int64_t number) const;
  void wake_joined(const Joint& joint);
  void show_excluded();
  void drop_last();
  void enter(std::int64_t body);
  void leave(std::span<const std::int64_t> bodies);
  std::vector<std::int64_t> take_out(std::span<const std::int64_t> ascending);
  void add_to_broad_phase(std::int32_t fixture);

  void remember();
  void check_joints(double dt) const;
  void go_back();
  void note_changes();
  void check_row(std::int64_t body);
  void place(double dt);
  void place_body(std::int64_t body, double dt);
  void list_fixtures(std::int64_t body);
  void find_contacts();
  void solve(double dt);
  std::int64_t solve_once(double dt);
  std::vector<std::uint8_t> contacts_at_rest() const;
  std::int64_t solve_from_rest(double dt, const std::vector<std::uint8_t>& at_rest);

  bool is_awake(std::int64_t body) const;  // and dynamic
  bool any_asleep() const;
  bool moves_now(std::int64_t body) const;  // or kinematic with a velocity
  bool displaced(std::int64_t body) const;
  bool wake_touched(double dt);
  bool left_its_place(std::int64_t body);
  void fall_asleep(double dt);
  void show_sleep(std::int64_t body);
  void sort_contacts(std::vector<ContactConstraint>& contacts);

  WorldOptions options_;
  Bodies bodies_;
  Fixtures fixtures_;
  Held<BroadPhase> broad_phase_;
  Held<ContactFinder> finder_;
  Held<ContactSolver> solver_;
  Islands islands_;
  std::vector<BodyPair> excluded_;
  std::vector<Joint> joints_;
  bool excluded_changed_ = false;
  std::vector<ContactConstraint> contacts_, last_contacts_, sleeping_contacts_;
  std::vector<double> rest_x_, rest_q_;      // (n, 3), (n, 4): see fall_asleep()
  std::vector<double> placed_x_, placed_q_;  // where fixtures_ has the bodies
  std::vector<std::uint8_t> asleep_;
  std::vector<Way> ways_;
  std::vector<std::int32_t> active_, moving_;  // bodies, and fixtures, that may move in this step
  std::vector<std::int32_t> displaced_;        // static and kinematic bodies that were moved
  std::vector<std::int32_t> woken_;            // since the contacts were last looked for
  bool sleep_changed_ = false;                 // since the contacts were last sorted
  std::vector<double> speed_;
  std::vector<BodyPair> touching_;
  Before before_;
};

}  // namespace substep::rigid
