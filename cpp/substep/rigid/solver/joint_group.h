// Bodies that joints connect, and the joints, solved for together (joints.h).
//
// A member's momenta are L and, in rows.velocity, that of its centre; rows.velocity.angular is what
// L means at the rotation of the sub-step's begin, in the coordinates of the step's begin. What
// others (forces, contacts, impacts) change there is added to L.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/usize.h"
#include "substep/rigid/motion/body_rows.h"
#include "substep/rigid/solver/joint_law.h"
#include "substep/rigid/solver/joint_matrix.h"
#include "substep/rigid/solver/joint_rows.h"

namespace substep::rigid {

class JointGroup {
 public:
  struct Settings {
    double h = 0;     // sub-step [s]
    double push = 0;  // most that a sub-step moves bodies to take back C [m], [rad]
    FreeRotation method = FreeRotation::kSplitting;
  };

  // numbers: of the joints of the group.
  JointGroup(std::vector<std::int32_t> numbers, std::span<const Joint> joints,
             const BodyRows& rows);

  // pressed: not 0 for bodies on which a contact presses.
  void begin_step(std::span<const Joint> joints, std::span<const std::uint8_t> pressed,
                  const Bodies& bodies, const Settings& settings, BodyRows& rows);
  void solve_velocities(BodyRows& rows, bool first);
  void move(BodyRows& rows);
  void solve_positions(BodyRows& rows);
  void end_step(BodyRows& rows);
  void store(Bodies& bodies, std::span<Joint> joints, double dt) const;

  // Whether forces at joints would swing a body faster than sub-steps follow.
  bool whirls() const { return whirls_; }
  void mark_bodies(std::span<std::uint8_t> bodies) const;  // that impulses move

 private:
  struct Place {
    Vec3 x;
    Quaternion q;
  };
  // A body. That of the world, of a static or a sleeping one has row 0.
  struct Member {
    std::int32_t body, row;
    bool moves;                 // by impulses
    double scale;               // 1 / sqrt(m)
    Vec3 inertia;               // principal moments
    Vec3 slow_inertia;          // those of the next sub-step
    Vec3 origin;                // position at the start of the step
    Mat3 root, unroot;          // W^(1/2) of the start of the step, and its inverse
    Mat3 W, W_root;             // of the start of the sub-step, W^(1/2)
    Place now;                  // at the start of the sub-step
    Vec3 seen_spin, seen_turn;  // velocity and displacement of the row that L and now agree with
    Vec3 seen_velocity;         // of the row, by the trial
    Vec3 v_before, w_before;    // velocities before the sub-step
    Vec3 start, start_turn;     // displacement at the start of the sub-step
    Vec3 given_v, given_w;      // what joints changed of the row's velocity in the sub-step
  };
  using Impulses = std::array<double, kJointRows>;

  struct Link {
    Joint joint;
    std::int32_t number, a, b;  // members
    int equations, rows;
    JointGradients G;
    std::array<double, kJointRows> begin;     // C at the start of the sub-step
    std::array<double, kJointRows> mobility;  // diagonal of G M^-1 G^T
    Impulses impulse;                         // l of the sub-step
    std::array<JointLaw, 3> law;
    std::array<JointLaw::Mode, 3> mode;
    Vec3 force, torque;  // impulses of the step
    double effort;       // along the coordinate

    bool active(int row) const {
      return row < equations || !JointLaw::fixes_impulse(mode[usize(row - equations)]);
    }
  };
  enum class Stage { kMotion, kVelocity };  // constraints of the trial motion, or of velocities

  std::int32_t member_of(std::int32_t body, const BodyRows& rows);
  Vec3 momentum(std::size_t member) const { return Vec3(&L_[3 * member]); }
  double rate(const Link& link, int row, const BodyRows& rows) const;
  double rate_before(const Link& link, int row) const;
  std::array<double, kJointRows> values(const Link& link, bool trial) const;  // else: now

  void refresh(std::size_t member, BodyRows& rows);
  bool read_momenta(const BodyRows& rows);
  void write_momenta(BodyRows& rows);
  void kick(double time, BodyRows& rows);
  void begin_substep(BodyRows& rows);
  void find_inertia();
  double correct_positions(BodyRows& rows);
  void set_inertia(std::size_t member, const Vec3& inertia, BodyRows& rows);
  void set_gradients();
  void set_laws(Link& link, Stage stage);
  void find_trial(const BodyRows& rows);
  void choose_modes(Stage stage, BodyRows& rows, bool& changed, bool& applied);
  double find_residuals(Stage stage, const BodyRows& rows);
  bool iterate(Stage stage, BodyRows& rows);
  void solve_motion(BodyRows& rows);
  void factor();
  void apply(Link& link, const Impulses& change, BodyRows& rows);
  void sum_impulses(Link& link) const;
  void turn_impulse(Link& link) const;

  Settings settings_;
  double regularisation_ = 0;
  bool smooth_ = false, factored_ = false, whirls_ = false;
  bool tried_ = false;  // whether the trial is that of the velocities
  double weight_ = 1;   // of the impulses of this sub-step: half of one, or a whole
  std::vector<Member> members_;
  std::vector<Link> links_;
  std::vector<double> q_, L_, inertia_;  // rows of members: trial rotations, momenta, moments
  std::vector<Place> trial_;
  JointMatrix matrix_;
  std::vector<JointMatrix::Piece> pieces_;
};

}  // namespace substep::rigid
