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

#include "substep/core/aligned_buffer.h"
#include "substep/core/point_scatter.h"
#include "substep/core/usize.h"
#include "substep/rigid/motion/body_rows.h"
#include "substep/rigid/solver/joint_law.h"
#include "substep/rigid/solver/joint_matrix.h"
#include "substep/rigid/solver/joint_rows.h"

namespace substep::rigid {

class JointGroup {
 public:
  struct Settings {
    double dt = 0;    // step [s]
    double h = 0;     // sub-step [s]
    double push = 0;  // most that a sub-step moves bodies to take back C [m], [rad]
    FreeRotation method = FreeRotation::kSplitting;
  };

  // numbers: of the joints of the group.
  JointGroup(std::vector<std::int32_t> numbers, std::span<const Joint> joints,
             const BodyRows& rows);

  // Most of h w of what forces at joints swing, where contacts press, and elsewhere.
  static constexpr double kSwing = 0.5, kFreeSwing = 1.5;

  // pressed: of bodies, kNear where a contact may press within the step, kPressed where one does.
  static constexpr std::uint8_t kNear = 1, kPressed = 2;
  void begin_step(std::span<const Joint> joints, std::span<const std::uint8_t> pressed,
                  const Bodies& bodies, const Settings& settings, BodyRows& rows);
  // first, last: sweep of the sub-step.
  void solve_velocities(BodyRows& rows, bool first, bool last);
  void move(BodyRows& rows);
  void solve_positions(BodyRows& rows);
  void end_step(BodyRows& rows);
  void store(Bodies& bodies, std::span<Joint> joints, double dt) const;

  // Whether forces at joints would swing a body faster than sub-steps follow.
  bool whirls() const { return whirls_; }
  void mark_bodies(std::span<std::uint8_t> bodies) const;  // that impulses move

 private:
  static constexpr int kLanes = kJointLanes;
  static constexpr double kTolerance = 1e-12;  // of C [m], [rad]
  using V = JointLanes;

  struct Places {
    AlignedBuffer<Point<double>> x, q;  // q: (w, x, y, z)
  };
  // A body. That of the world, of a static or a sleeping one has row 0.
  struct Member {
    std::int32_t body, row;
    bool moves;                 // by impulses
    double scale;               // 1 / sqrt(m)
    Vec3 inertia;               // principal moments
    Vec3 seen_inertia;          // those that impulses find in this sub-step
    Vec3 origin;                // position at the start of the step
    Mat3 root, unroot;          // W^(1/2) of the start of the step, and its inverse
    Mat3 W;                     // of the start of the sub-step
    Mat3 response;              // W for impulses
    Mat3 part;                  // of an impulse's moment that turns it: its response over W
    Vec3 seen_spin, seen_turn;  // velocity and displacement of the row that L agrees with
    Vec3 seen_velocity;         // of the row, by the trial
    Vec3 start, start_turn;     // displacement at the start of the sub-step

    bool slow() const { return seen_inertia != inertia; }
  };
  struct Link {
    Joint joint;
    std::int32_t number, a, b;  // members
    int equations, rows;
    std::array<JointLaw, 3> law;
    std::array<JointLaw::Mode, 3> mode;

    bool active(int row) const {
      return row < equations || !JointLaw::fixes_impulse(mode[usize(row - equations)]);
    }
  };
  // Links of one type in lanes; lanes that are left have the first link again.
  struct Pack {
    JointType type;
    int count, equations, rows;  // rows: most that a link has
    std::int32_t link[kLanes], a[kLanes], b[kLanes];
    JointFrames in_a, in_b;
    JointGradients G;
    V scaled_a[kJointRows][JointMatrix::kSize];  // G in coordinates of mass and inertia 1
    V scaled_b[kJointRows][JointMatrix::kSize];
    V mobility[kJointRows];     // diagonal of G M^-1 G^T
    V begin[kJointRows];        // C at the start of the sub-step
    V rate[kJointRows];         // of C: mean of the trial motion, or of velocities
    V beyond[kJointRows];       // what rates of the trial have beyond those of its velocities
    V impulse[kJointRows];      // l of the sub-step
    V last[kJointRows];         // that of the one before, turned with the bodies
    V coordinate;               // angles are those nearest to it
    JointVector force, torque;  // impulses of the step
    V effort;                   // along the coordinate
  };
  struct Wrench {
    JointVector force, torque_a, torque_b;
  };
  using Stage = JointLaw::Stage;  // constraints of the trial motion, or of velocities

  std::int32_t member_of(std::int32_t body, const BodyRows& rows);
  void pack();
  Vec3 momentum(std::size_t member) const { return Vec3(&L_[3 * member]); }
  void give(std::size_t member, const Vec3& moment) {  // of an impulse
    const Member& m = members_[member];
    Eigen::Map<Vec3> L(&L_[3 * member]);
    if (m.slow())
      L += m.part * moment;
    else
      L += moment;
  }
  Quaternion rotation(std::size_t member) const { return load_quaternion(&now_.q[member].x); }
  // By a displacement, with what it turns at: of a thin body another axis has other energy.
  void turn(std::size_t member, const Vec3& by) {
    const Quaternion turned = rotation_by(by);
    store_quaternion((turned * rotation(member)).normalized(), &now_.q[member].x);
    Vec3::Map(&L_[3 * member]) = turned * momentum(member);
  }

  static JointQuaternion rotations(const Places& places, const std::int32_t* members);
  static JointSides sides(const JointFrames& frames, const Places& places,
                          const std::int32_t* members);
  static void find_values(const Pack& pack, const Places& places, bool coordinates, V* C);
  static void find_velocity_rates(Pack& pack, const AlignedBuffer<BodyRow>& velocities);
  static Wrench wrench(const Pack& pack, const V* l);
  // task(member, force, torque) of the links' sides.
  template <class F>
  static void each_side(const Pack& pack, const Wrench& wrench, const F& task) {
    Point<double> force[kLanes], a[kLanes], b[kLanes];
    const auto split = [](const JointVector& v, Point<double>* to) {
      store_rows<V>({v[0], v[1], v[2], V{}}, [&](int lane) { return to + lane; });
    };
    split(wrench.force, force), split(wrench.torque_a, a), split(wrench.torque_b, b);
    for (int lane = 0; lane < pack.count; ++lane) {
      task(usize(pack.a[lane]), load_quad(force[lane]), load_quad(a[lane]));
      task(usize(pack.b[lane]), -load_quad(force[lane]), -load_quad(b[lane]));
    }
  }
  void load_pieces(const Pack& pack, V* l) const;
  void store_pieces(const Pack& pack, const V* l);

  void refresh(std::size_t member, BodyRows& rows);
  void refresh_within(std::size_t member, BodyRows& rows);
  bool read_momenta(const BodyRows& rows);
  void write_momenta(BodyRows& rows);
  void kick(double time, BodyRows& rows);
  void begin_substep(BodyRows& rows);
  void find_inertia(BodyRows& rows);
  double correct_positions(BodyRows& rows);
  void see_inertia(std::size_t member, const Vec3& inertia, BodyRows& rows);
  void set_gradients();
  void set_laws(Pack& pack, Stage stage);
  void find_trial(const BodyRows& rows);
  void find_motion_rates(const BodyRows& rows);
  void find_rates(const BodyRows& rows);
  int choose_modes(bool one, bool& fixed);
  double find_residuals();
  bool solve_linear(Stage stage, BodyRows& rows, int others);
  bool solve(Stage stage, BodyRows& rows, double tolerance);
  void take_back(BodyRows& rows);
  bool slow_springs(const BodyRows& rows);
  bool whirled() const;
  void solve_motion(BodyRows& rows, double tolerance);
  void factor();
  void apply(BodyRows& rows);
  static void sum_impulses(Pack& pack);
  void turn_impulses(Pack& pack) const;

  Settings settings_;
  double regularisation_ = 0;
  bool loops_ = false;        // not a tree
  bool has_laws_ = false;     // of any coordinate
  bool has_springs_ = false;  // at what turns
  bool closes_ = false;       // whether the motion leads to C = 0, not to what C was
  bool smooth_ = false, factored_ = false, whirls_ = false;
  bool tried_ = false;   // whether the trial is that of the velocities
  bool solved_ = false;  // whether that is the motion sought, but for what contacts change
  bool begins_ = false;  // whether this sub-step is the first
  double weight_ = 1;    // of the impulses of this sub-step: half of one, or a whole
  std::vector<Member> members_;
  std::vector<Link> links_;
  std::vector<Pack> packs_;
  std::vector<double> L_, inertia_;  // rows of members
  AlignedBuffer<BodyRow> root_;      // W^(1/2) of the start of the sub-step, as in BodyRows
  AlignedBuffer<BodyRow> before_;    // velocities before the sub-step
  AlignedBuffer<BodyRow> given_;     // what joints changed of the row's velocity, in the sub-step
  AlignedBuffer<BodyRow> sums_;      // velocities, or impulses of each member
  Places now_, trial_;               // at the start of the sub-step, and at its end
  JointMatrix matrix_;
  std::vector<JointMatrix::Piece> pieces_;  // by links
};

}  // namespace substep::rigid
