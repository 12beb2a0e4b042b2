#include "substep/rigid/solver/stick_slip.h"

#include <algorithm>
#include <cmath>

namespace substep::rigid {
namespace {

// What sweeps have not converged is no slip: parts of the bound and of the fast speed. A table
// whose feet share the friction, at 0.9 of what all of them hold, has a foot at its bound that
// moves by half of it.
constexpr double kBeyond = 1e-3, kMoves = 5e-3;

// (u_t, w_n)
Vec3 velocity(const ContactConstraint& c, const BodyRows& rows) {
  const std::int32_t a = rows.row(c.a), b = rows.row(c.b);
  const Vec3 w_a = rows.spin_of(a), w_b = rows.spin_of(b);
  const Vec3 u = rows.velocity_of(b) + w_b.cross(c.middle(&ContactConstraint::Point::arm_b)) -
                 rows.velocity_of(a) - w_a.cross(c.middle(&ContactConstraint::Point::arm_a));
  return {u.dot(c.tangent), u.dot(c.normal.cross(c.tangent)), (w_b - w_a).dot(c.normal)};
}

}  // namespace

void begin_slip(const BodyRows& rows, double fast, ContactConstraint& contact) {
  Vec3 u = velocity(contact, rows);
  u[2] = 0;
  contact.slips = u.norm() > fast;
  Vec3::Map(contact.slip) = u;
}

void note_slip(const ContactPacket& packet, int lane, const BodyRows& rows, double fast,
               ContactConstraint& contact) {
  double press = 0, lever = 0;
  for (int k = 0; k < contact.count; ++k) {
    press += packet.impulse[k][lane];
    lever += packet.impulse[k][lane] * static_cast<double>(packet.lever[k][lane]);
  }
  if (!(press > 0)) return begin_slip(rows, fast, contact);

  Vec3 u = velocity(contact, rows);
  for (int i = 0; packet.rolls_on && i < 2; ++i) u[i] += static_cast<double>(packet.bias[i][lane]);
  // What would hold it.
  const Vec3 x = u / packet.mobility[lane];
  const auto inverse = [&](int k) { return static_cast<double>(packet.slide_inverse[k][lane]); };
  const double hold[2] = {packet.slide_impulse[0][lane] - inverse(0) * x[0] - inverse(1) * x[1],
                          packet.slide_impulse[1][lane] - inverse(1) * x[0] - inverse(2) * x[1]};
  const double twist =
      packet.twist_impulse[lane] - static_cast<double>(packet.twist_inverse[lane]) * x[2];
  const double most = (1 + kBeyond) * contact.mu();
  const bool slides = std::hypot(hold[0], hold[1]) > most * press;
  const bool spins = lever > 0 && std::abs(twist) > most * lever + contact.spinning * press;

  u[2] *= lever / press;
  Eigen::Map<Vec3> s(contact.slip);
  if (contact.slips) {
    contact.slips = u.dot(s) > 0 && u.dot(2 * u - s) > 0;
    s = contact.slips ? u : Vec3(Vec3::Zero());
  } else if (slides || spins) {
    const double speed = u.norm();
    contact.slips = speed > fast || (!s.isZero(0) && speed > std::max(kMoves * fast, s.norm()));
    s = u;
  } else {
    s.setZero();
  }
}

}  // namespace substep::rigid
