#include "substep/mpm/implicit/contacts.h"

#include <algorithm>
#include <cmath>

#include "substep/core/usize.h"

namespace substep::mpm {
namespace {

using geometry::Vec3;

template <int D>
Vec3 vector_at(std::span<const double> x, std::size_t node) {
  Vec3 v = Vec3::Zero();
  for (int d = 0; d < D; ++d) {
    v[d] = x[node * kNodeLanes<D> + usize(d)];
  }
  return v;
}
template <int D>
void set_vector(std::span<double> x, std::size_t node, const Vec3& v) {
  for (int d = 0; d < D; ++d) {
    x[node * kNodeLanes<D> + usize(d)] = v[d];
  }
}

constexpr double kSharper = 10;  // smooth friction becomes sharp from round to round

constexpr double kParallel = 1e-6;  // sine of the angle below which normals are the same

}  // namespace

// n_k = sum_{l <= k} R_kl q_l with orthonormal q (Gram and Schmidt); normals that add nothing are
// left out. An impulse r is sum_k lambda_k n_k and a part across all of them.
template <int D>
struct ImplicitContacts<D>::Frame {
  int size = 0;
  std::size_t contact[3];
  Vec3 q[3];
  double R[3][3];

  void add(std::size_t k, const Vec3& n) {
    if (size == D) return;
    Vec3 rest = n;
    for (int l = 0; l < size; ++l) {
      R[size][l] = n.dot(q[l]);
      rest -= R[size][l] * q[l];
    }
    const double length = rest.norm();
    if (length < kParallel) return;
    R[size][size] = length;
    q[size] = rest / length;
    contact[size++] = k;
  }
  void coefficients(const Vec3& r, double (&lambda)[3]) const {
    for (int l = size - 1; l >= 0; --l) {
      double sum = r.dot(q[l]);
      for (int k = l + 1; k < size; ++k) sum -= R[k][l] * lambda[k];
      lambda[l] = sum / R[l][l];
    }
  }
  Vec3 across(const Vec3& r) const {
    Vec3 rest = r;
    for (int l = 0; l < size; ++l) rest -= r.dot(q[l]) * q[l];
    return rest;
  }
};

template <int D>
auto ImplicitContacts<D>::frame(const ContactNode& node) const -> Frame {
  Frame f;
  for (std::size_t k = node.first; k < node.first + node.count; ++k) {
    if (contacts_[k].active) f.add(k, contacts_[k].normal);
  }
  return f;
}

template <int D>
template <class Real>
void ImplicitContacts<D>::assign(const ImplicitNodes<D>& nodes,
                                 const NodeDistances<Real, D>& distances,
                                 std::span<const geometry::Collider> colliders,
                                 std::span<const Boundary> boundaries, double cell) {
  contacts_.clear();
  nodes_in_contact_.clear();
  colliders_ = colliders.size();
  for (std::size_t i = 0; i < nodes.count(); ++i) {
    const auto slot = usize(nodes.slots[i]);
    const auto block = static_cast<std::int32_t>(slot / ImplicitNodes<D>::kPerBlock);
    const std::size_t local = slot % ImplicitNodes<D>::kPerBlock;
    const std::size_t first = contacts_.size();
    for (const auto& held : distances.held(block)) {
      const std::size_t c = distances.all()[usize(held.surface)].collider;
      const Real* const value = distances.patch(held).values + 4 * local;
      if (!(value[3] <= 0)) continue;
      const auto coordinates = nodes.coordinates(i);
      Vec3 x = Vec3::Zero(), n = Vec3::Zero();
      for (int d = 0; d < D; ++d) {
        x[d] = cell * coordinates[usize(d)];
        n[d] = static_cast<double>(value[d]);
      }
      const double length = n.norm();
      if (!(length > 0)) continue;
      Vec3 u = colliders[c].surface_velocity(x);
      if (D == 2) u[2] = 0;
      contacts_.push_back({static_cast<std::int32_t>(c), n / length, u, x - colliders[c].position(),
                           colliders[c].friction, boundaries[c], false});
    }
    if (contacts_.size() == first) continue;
    nodes_in_contact_.push_back({.node = i,
                                 .first = first,
                                 .count = contacts_.size() - first,
                                 .mass = nodes.mass[i],
                                 .sticky = false});
    for (std::size_t k = first; k < contacts_.size(); ++k) {
      nodes_in_contact_.back().sticky |= contacts_[k].boundary == Boundary::kSticky;
    }
  }
}

// P and the given components of what touches.
template <int D>
void ImplicitContacts<D>::rebuild(ContactNode& node) {
  const auto begin = contacts_.begin() + static_cast<std::ptrdiff_t>(node.first);
  const auto end = begin + static_cast<std::ptrdiff_t>(node.count);
  if (node.sticky) {
    const auto holds = [](const Contact& c) { return c.boundary == Boundary::kSticky; };
    node.free.setZero();
    node.given = std::find_if(begin, end, holds)->surface_velocity;
    return;
  }
  const Frame f = frame(node);
  node.free.setIdentity();
  node.given.setZero();
  node.surface = f.size > 0 ? contacts_[f.contact[0]].surface_velocity : Vec3(Vec3::Zero());
  for (int l = 0; l < f.size; ++l) {
    // n_l . v = n_l . u_l, where v has q_m . v = q_m . given for m < l already.
    const Contact& contact = contacts_[f.contact[l]];
    double along = contact.normal.dot(contact.surface_velocity);
    for (int m = 0; m < l; ++m) along -= f.R[l][m] * f.q[m].dot(node.given);
    node.given += along / f.R[l][l] * f.q[l];
    node.free -= f.q[l] * f.q[l].transpose();
  }
}

template <int D>
void ImplicitContacts<D>::predict(std::span<const double> v, double slip_speed, double smoothing) {
  least_slip_speed_ = slip_speed;
  slip_speed_ = smoothing * slip_speed;
  for (ContactNode& node : nodes_in_contact_) {
    const Vec3 velocity = vector_at<D>(v, node.node);
    node.bound = 0;
    for (std::size_t k = node.first; k < node.first + node.count; ++k) {
      Contact& contact = contacts_[k];
      const double approach = contact.normal.dot(velocity - contact.surface_velocity);
      contact.active = contact.boundary != Boundary::kSeparate || approach < 0;
      node.bound += contact.friction * node.mass * std::max(-approach, 0.0);
    }
    rebuild(node);
  }
}

template <int D>
void ImplicitContacts<D>::press(std::span<const double> r) {
  for (ContactNode& node : nodes_in_contact_) {
    if (node.sticky) continue;
    const Frame f = frame(node);
    double lambda[3] = {0, 0, 0};
    f.coefficients(vector_at<D>(r, node.node), lambda);
    node.bound = 0;
    for (int l = 0; l < f.size; ++l) {
      node.bound += contacts_[f.contact[l]].friction * std::max(lambda[l], 0.0);
    }
  }
}

template <int D>
bool ImplicitContacts<D>::update(std::span<const double> v, std::span<const double> r,
                                 double tolerance) {
  bool switched = false, rubs = false;
  double squares = 0, changes = 0;
  for (const ContactNode& node : nodes_in_contact_) {
    squares += vector_at<D>(r, node.node).squaredNorm();
  }
  // What a node alone may be off by.
  const double noise =
      tolerance * std::sqrt(squares / static_cast<double>(nodes_in_contact_.size()));
  for (ContactNode& node : nodes_in_contact_) {
    if (node.sticky) continue;
    const Vec3 velocity = vector_at<D>(v, node.node);
    const Frame f = frame(node);
    double lambda[3] = {0, 0, 0}, bound = 0;
    f.coefficients(vector_at<D>(r, node.node), lambda);
    bool changed = false;
    for (int l = 0; l < f.size; ++l) {
      Contact& contact = contacts_[f.contact[l]];
      bound += contact.friction * std::max(lambda[l], 0.0);
      if (contact.boundary == Boundary::kSeparate && lambda[l] < -noise) {
        contact.active = false;
        changed = true;
      }
    }
    for (std::size_t k = node.first; k < node.first + node.count; ++k) {
      Contact& contact = contacts_[k];
      const double approach = contact.normal.dot(velocity - contact.surface_velocity);
      if (!contact.active && approach < -least_slip_speed_) contact.active = changed = true;
    }
    changes += (bound - node.bound) * (bound - node.bound);
    node.bound = bound;
    rubs = rubs || bound > noise;
    if (changed) rebuild(node);
    switched = switched || changed;
  }
  const bool sharp = !(slip_speed_ > least_slip_speed_) || !rubs;
  slip_speed_ = std::max(slip_speed_ / kSharper, least_slip_speed_);
  return switched || !sharp || changes > tolerance * tolerance * squares;
}

// u_t
template <int D>
Vec3 ImplicitContacts<D>::slip(const ContactNode& node, std::span<const double> v) const {
  return node.free * (vector_at<D>(v, node.node) - node.surface);
}

template <int D>
double ImplicitContacts<D>::energy(std::span<const double> v) const {
  const double e = slip_speed_;
  double sum = 0;
  for (const ContactNode& node : nodes_in_contact_) {
    if (!(node.bound > 0)) continue;
    const double y = slip(node, v).norm();
    sum += node.bound * (y < e ? y * y / e - y * y * y / (3 * e * e) + e / 3 : y);
  }
  return sum;
}

template <int D>
void ImplicitContacts<D>::add_gradient(std::span<const double> v, std::span<double> r) const {
  const double e = slip_speed_;
  for (const ContactNode& node : nodes_in_contact_) {
    if (!(node.bound > 0)) continue;
    const Vec3 u = slip(node, v);
    const double y = u.norm();
    const double over_y = y < e ? (2 - y / e) / e : 1 / y;  // f_1 / y
    set_vector<D>(r, node.node, vector_at<D>(r, node.node) + node.bound * over_y * u);
  }
}

// d(f_1 u / y)/du = f_1 / y (1 - t t^T) + f_1' t t^T with t = u / y, in the tangent plane.
template <int D>
void ImplicitContacts<D>::linearise(std::span<const double> v) {
  const double e = slip_speed_;
  for (ContactNode& node : nodes_in_contact_) {
    node.curvature.setZero();
    if (!(node.bound > 0)) continue;
    const Vec3 u = slip(node, v);
    const double y = u.norm();
    const double over_y = y < e ? (2 - y / e) / e : 1 / y;
    const double slope = y < e ? 2 * (1 - y / e) / e : 0;  // f_1'
    node.curvature = node.bound * over_y * node.free;
    if (y > 0) node.curvature += node.bound * (slope - over_y) / (y * y) * u * u.transpose();
  }
}

template <int D>
void ImplicitContacts<D>::add_product(std::span<const double> x, std::span<double> y) const {
  for (const ContactNode& node : nodes_in_contact_) {
    if (!(node.bound > 0)) continue;
    set_vector<D>(y, node.node,
                  vector_at<D>(y, node.node) + node.curvature * vector_at<D>(x, node.node));
  }
}

template <int D>
void ImplicitContacts<D>::add_diagonal(std::span<double> blocks) const {
  for (const ContactNode& node : nodes_in_contact_) {
    for (int l = 0; l < D; ++l) {
      for (int j = 0; j < D; ++j) {
        blocks[(node.node * D + usize(l)) * kNodeLanes<D> + usize(j)] += node.curvature(l, j);
      }
    }
  }
}

template <int D>
void ImplicitContacts<D>::project(std::span<double> x) const {
  for (const ContactNode& node : nodes_in_contact_) {
    set_vector<D>(x, node.node, node.free * vector_at<D>(x, node.node));
  }
}

template <int D>
void ImplicitContacts<D>::impose(std::span<double> v) const {
  for (const ContactNode& node : nodes_in_contact_) {
    set_vector<D>(v, node.node, node.free * vector_at<D>(v, node.node) + node.given);
  }
}

template <int D>
void ImplicitContacts<D>::keep_out(std::span<double> v) const {
  for (const ContactNode& node : nodes_in_contact_) {
    for (std::size_t k = node.first; k < node.first + node.count; ++k) {
      const Contact& contact = contacts_[k];
      const Vec3 velocity = vector_at<D>(v, node.node);
      const double approach = contact.normal.dot(velocity - contact.surface_velocity);
      if (approach < 0) set_vector<D>(v, node.node, velocity - approach * contact.normal);
    }
  }
}

template <int D>
std::vector<geometry::Exchange> ImplicitContacts<D>::exchanges(std::span<const double> r) const {
  std::vector<geometry::Exchange> given(colliders_);
  for (const ContactNode& node : nodes_in_contact_) {
    const Vec3 impulse = vector_at<D>(r, node.node);
    const Frame f = frame(node);
    if (f.size == 0) continue;
    double lambda[3] = {0, 0, 0};
    f.coefficients(impulse, lambda);
    // What is across the normals goes to those that press most, or that hold it.
    int most = 0;
    for (int l = 0; l < f.size; ++l) {
      const Contact& contact = contacts_[f.contact[l]];
      given[usize(contact.collider)].add(contact.arm, -lambda[l] * contact.normal);
      if (contact.boundary == Boundary::kSticky ||
          contact.friction * lambda[l] >
              contacts_[f.contact[most]].friction * std::max(lambda[most], 0.0)) {
        most = l;
      }
    }
    const Contact& holder = contacts_[f.contact[most]];
    given[usize(holder.collider)].add(holder.arm, -f.across(impulse));
  }
  return given;
}

template class ImplicitContacts<2>;
template class ImplicitContacts<3>;
#define SUBSTEP_ASSIGN(Real, D)                                                                    \
  template void ImplicitContacts<D>::assign(                                                       \
      const ImplicitNodes<D>&, const NodeDistances<Real, D>&, std::span<const geometry::Collider>, \
      std::span<const Boundary>, double);
SUBSTEP_ASSIGN(float, 2)
SUBSTEP_ASSIGN(float, 3)
SUBSTEP_ASSIGN(double, 2)
SUBSTEP_ASSIGN(double, 3)
#undef SUBSTEP_ASSIGN

}  // namespace substep::mpm
