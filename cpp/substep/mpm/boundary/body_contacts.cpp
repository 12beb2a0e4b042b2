#include "substep/mpm/boundary/body_contacts.h"

#include <algorithm>

namespace substep::mpm {
namespace {

using geometry::Mat3;
using geometry::Mat6;
using geometry::Vec3;
using geometry::Vec6;

// Of a contact, per unit of its mass: j, dj/du and psi.
struct Response {
  Vec3 change = Vec3::Zero();
  Mat3 slope = Mat3::Zero();
  double energy = 0;
};

// [a]_x
Mat3 crossing(const Vec3& a) {
  return (Mat3() << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0).finished();
}

Vec3 surface_velocity(const BodyContact& contact, const Vec6& V) {
  return V.head<3>() + V.tail<3>().cross(contact.arm);
}

bool presses(const BodyContact& contact, double normal) {
  return normal < 0 || contact.boundary == Boundary::kSlip;
}

double friction_bound(const BodyContact& contact, const Vec6& V) {
  const double normal = contact.n.dot(contact.v - surface_velocity(contact, V));
  return contact.friction * std::max(-normal, 0.0);
}

Response respond(const BodyContact& contact, const Vec6& V) {
  const Vec3 relative = contact.v - surface_velocity(contact, V);
  if (contact.boundary == Boundary::kSticky) {
    return {-relative, Mat3::Identity(), 0.5 * relative.squaredNorm()};
  }
  Response r;
  const Vec3& n = contact.n;
  const double normal = relative.dot(n);
  if (presses(contact, normal)) {
    r = {-normal * n, n * n.transpose(), 0.5 * normal * normal};
  }
  if (!(contact.bound > 0)) return r;
  const Vec3 along = relative - normal * n;
  const double speed = along.norm(), bound = contact.bound;
  const Mat3 tangent = Mat3::Identity() - n * n.transpose();
  if (speed <= bound) {
    r.change -= along;
    r.slope += tangent;
    r.energy += 0.5 * speed * speed;
  } else {
    const double share = bound / speed;
    r.change -= share * along;
    r.slope += share * (tangent - along * along.transpose() / (speed * speed));
    r.energy += bound * (speed - 0.5 * bound);
  }
  return r;
}

struct Sums {
  Vec6 impulse = Vec6::Zero();  // sum G^T j
  Mat6 slope = Mat6::Zero();    // H
  double energy = 0;            // sum m |j / m|^2
};

Sums sums(std::span<const BodyContact> contacts, const Vec6& V) {
  Sums s;
  for (const BodyContact& contact : contacts) {
    const Response r = respond(contact, V);
    const Vec3 j = contact.mass * r.change;
    const Mat3 A = contact.mass * r.slope, R = crossing(contact.arm), RA = R * A;
    s.impulse.head<3>() += j;
    s.impulse.tail<3>() += contact.arm.cross(j);
    s.slope.topLeftCorner<3, 3>() += A;
    s.slope.topRightCorner<3, 3>() -= A * R;
    s.slope.bottomLeftCorner<3, 3>() += RA;
    s.slope.bottomRightCorner<3, 3>() -= RA * R;
    s.energy += j.dot(r.change);
  }
  return s;
}

// phi
double merit(std::span<const BodyContact> contacts, const Vec6& V, const Vec6& y, const Vec6& Wy) {
  double sum = 0.5 * y.dot(Wy);
  for (const BodyContact& contact : contacts) sum += contact.mass * respond(contact, V + Wy).energy;
  return sum;
}

}  // namespace

void meet(const Vec6& velocity, const Mat6& mobility, std::span<BodyContact> contacts) {
  // After so many iterations the bounds of friction stay, with which the rest surely converges.
  constexpr int kBounds = 20, kIterations = 40, kHalvings = 10;
  constexpr double kConverged = 1e-18;  // energy of a correction, of that of all impulses
  constexpr double kLess = 1e-4;        // share of the slope by which phi must fall
  constexpr double kRounding = 1e-13;   // of phi
  Vec6 y = Vec6::Zero(), V = velocity;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    if (iteration < kBounds) {
      for (BodyContact& contact : contacts) contact.bound = friction_bound(contact, V);
    }
    const Sums now = sums(contacts, V);
    const Mat6 matrix = Mat6::Identity() + now.slope * mobility;
    const Vec6 F = y + now.impulse, dy = matrix.partialPivLu().solve(-F), step = mobility * dy;
    const double left = dy.dot(step);
    const bool converged = !(left > kConverged * (now.energy + y.dot(mobility * y)));
    double part = 1;
    if (!converged) {
      const double before = (1 + kRounding) * merit(contacts, velocity, y, mobility * y);
      for (int k = 0; k < kHalvings; ++k, part /= 2) {
        const Vec6 to = y + part * dy;
        const double most = before + kLess * part * F.dot(step);
        if (merit(contacts, velocity, to, mobility * to) <= most) break;
      }
    }
    y += part * dy;
    V = velocity + mobility * y;
    if (converged) break;
  }
  for (BodyContact& contact : contacts) contact.impulse = contact.mass * respond(contact, V).change;
}

}  // namespace substep::mpm
