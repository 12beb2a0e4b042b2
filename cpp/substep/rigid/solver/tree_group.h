// A JointGroup that is a tree, solved for in the coordinates of its joints (articulated_tree.h):
// the same motion as JointGroup's to second order, in a fraction of its time.
//
// Serves a step of bodies whose joints are hinges and sliders, with limits and motors, and balls
// and fixed joints without, closed, that turn little in a sub-step and are not swung fast by the
// forces at their joints.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "substep/core/usize.h"
#include "substep/rigid/motion/body_rows.h"
#include "substep/rigid/solver/articulated_tree.h"
#include "substep/rigid/solver/joint.h"
#include "substep/rigid/solver/joint_group.h"
#include "substep/rigid/solver/joint_law.h"
#include "substep/rigid/solver/tree_rows.h"

namespace substep::rigid {

class TreeGroup {
 public:
  // Of the joints of these numbers; none if they are no tree of such bodies and joints.
  static std::optional<TreeGroup> make(std::span<const std::int32_t> numbers,
                                       std::span<const Joint> joints, const BodyRows& rows);

  // As JointGroup's (joint_group.h). false: the step is none for this group, and rows are as
  // before.
  bool begin_step(std::span<const Joint> joints, std::span<const std::uint8_t> pressed,
                  const Bodies& bodies, const JointGroup::Settings& settings, BodyRows& rows);
  void solve_velocities(BodyRows& rows, bool first, bool last);
  void move(BodyRows& rows);
  void end_step(BodyRows& rows);
  void store(Bodies& bodies, std::span<Joint> joints, double dt) const;
  bool whirls() const { return whirls_; }

 private:
  using Tree = ArticulatedTree;

  static constexpr double kClosed = 1e-6;      // errors of joints that are small [m], [rad]
  static constexpr double kMostTurn = 1;       // of a body in a sub-step [rad]
  static constexpr double kMostGrowth = 0.5;   // of an error in an iteration
  static constexpr double kShortest = 1e-30;   // sub-step: momenta are found from positions [s]
  static constexpr double kMostWhirl = 0.3;    // of a body in a sub-step of a tree alone [rad]
  static constexpr double kMostEnergy = 1.05;  // of a motion, over that of the momenta before
  static constexpr int kIterations = 60, kIterationsAlone = 20;
  static constexpr int kMostParts = 64;                     // of a sub-step
  static constexpr double kLeastPart = 0.3, kMostPart = 4;  // of a step of Newton's method
  // What may be left of an error of the motion [m], [rad]: of a tree that nothing holds, whose
  // momenta stay what they are, of others, where contacts press, and what they will still change.
  static constexpr double kFree = 1e-12, kHeld = 1e-10, kPressed = 1e-8, kEnough = 1e-6;
  static constexpr int kPivots = 100;         // of modes
  static constexpr double kSurely = 0.99;     // of a bound, so that rounding is none
  static constexpr double kLittle = 1e-12;    // by which a law may be missed [rad], [m]
  static constexpr double kPassed = 1e-7;     // a limit [rad]
  static constexpr double kMostSprung = 0.5;  // turn by a spring that yields, in a sub-step [rad]
  static constexpr double kClose = 1e-5;      // change of an iteration that has not found it

  // The body of a part, and its joint, -1 if it has none.
  struct Member {
    std::int32_t body, joint;
    bool is_a;  // the joint's a is this body
    Quad3 inverse_inertia;
    Tree::Momentum impulse;  // of the joint on this body at the anchor, in the last sub-step
    Tree::Momentum sum;      // in the step
    double coordinate;       // of the joint, but for rounding
    // Of a hinge or a slider with limits or a motor, along its coordinate:
    bool ruled;
    double lower, upper;
    Joint::Motor motor;
    JointLaw law;
    JointLaw::Mode mode;
    double rate;                // of the sub-step before
    double mobility;            // change of the rate by an impulse, of its bodies apart
    double along, given_along;  // impulse of the sub-step, and what the momenta have of it
    double last, sum_along;     // that of the sub-step before, and of the step
  };
  // Of forces at the joints of a body that swing it, in its frame: K for the axes, sum of K r and
  // K.
  struct Arm {
    Quad3 stiffness{}, arm{};
    double sum = 0;
  };

  TreeGroup(std::vector<Tree::Part> parts, std::vector<Member> members);
  void set_joint(std::size_t k, const Joint& joint, const Bodies& bodies);
  bool set_coordinates(const Bodies& bodies);
  void find_inertia(BodyRows& rows);
  template <class Call>
  void for_each_arm(const Call& call) const;
  bool may_swing(double scale);
  void see_inertia(std::size_t k, const Quad3& inertia, BodyRows& rows);
  Quad3 moment(std::size_t k, const Quad3& change) const;
  void kick(double time, BodyRows& rows);
  template <class Call>
  void give(const Call& momentum, BodyRows& rows);
  void guess_rates();
  void begin_substep(BodyRows& rows);
  void begin_motion();
  bool solve(double tolerance, bool known = false);
  bool is_near() const;
  bool solve_in_parts(double tolerance, BodyRows& rows);
  void give_found(BodyRows& rows);
  using Stage = JointLaw::Stage;
  double sign(std::size_t k) const { return members_[k].is_a ? 1 : -1; }  // of the coordinate
  bool slides(std::size_t k) const { return tree_.parts()[k].kind == Tree::Kind::kSlider; }
  void take_back_limits();
  double coordinate(std::size_t k) const;
  double passed(std::size_t k) const;
  double mean_rate(std::size_t k) const;
  void set_laws(Stage stage);
  double base_rate(Stage stage, std::size_t k) const;
  void set_drives(Stage stage);
  int choose_modes(Stage stage, bool one);
  bool respond(Stage stage);
  void read_impulses();
  bool slow_springs(Stage stage, std::span<const Tree::Rate> rates);
  void take_velocities(BodyRows& rows);
  void solve_motion(double tolerance, bool known, BodyRows& rows);
  void move_in_tree(double part);
  void count_turns();
  void project();
  void follow(std::span<Tree::Coordinate> coordinates);
  void sum_impulses(double weight);

  Tree tree_;
  TreeRows rows_;
  std::vector<Member> members_;
  double mass_ = 0;
  double push_ = 0;             // most that a sub-step takes back of a passed limit [m], [rad]
  double substep_ = 0, h_ = 0;  // what is solved for: the sub-step, or a part of it
  double weight_ = 1;   // of forces in the sub-step: half of one where a step begins and ends
  bool ruled_ = false;  // whether any joint is
  bool smooth_ = false, solved_ = false, factored_ = false, whirls_ = false;
  bool moves_as_found_ = false;  // the motion of the sub-step is one that solve() found
  double error_ = 0;             // estimated, of that motion [m], [rad]
  bool alone_ = false;           // nothing touches it, so that rows need not follow before the end
  double turn_ = 0, drift_ = 0;  // largest turn in the sub-step; way from where the matrix is of
  std::int64_t factors_ = 0;     // so far
  std::int64_t intervals_ = 0;   // of this step
  std::vector<Tree::Coordinate> begin_, end_;  // of the sub-step
  std::vector<Tree::Place> now_, next_;        // there
  std::vector<Tree::Momentum> momenta_;        // of the bodies
  std::vector<Tree::Momentum> found_;          // of the motion from now_ to next_
  std::vector<Tree::Momentum> wanted_;
  std::vector<Tree::Momentum> given_;  // by joints, in the sub-step
  std::vector<Tree::Rate> rates_, last_rates_, older_rates_, change_, last_change_;
  std::vector<Tree::Momentum> aside_;  // displacements of centres, and turns
  std::vector<Arm> arms_;
  std::vector<Quad3> turns_;
};

}  // namespace substep::rigid
