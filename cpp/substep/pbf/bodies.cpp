#include "substep/pbf/bodies.h"

#include <algorithm>
#include <cmath>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::pbf {
namespace {

// The mobility of motion in the plane: along x and y, and about z.
Mat6 in_plane(const Mat6& w) {
  const Vec6 kept = geometry::joined({1, 1, 0}, {0, 0, 1});
  return kept.asDiagonal() * w * kept.asDiagonal();
}

template <class Real>
double mass_of(std::span<const Real> mass, std::int32_t i) {
  return mass[mass.size() == 1 ? 0 : usize(i)];
}

}  // namespace

Vec6 respond(const Mat6& w, const Mat6& k, const Vec6& f) {
  return (Mat6::Identity() + w * k).partialPivLu().solve(w * f);
}

Vec6 solve_rows(const Mat6& w, std::span<BodyRow> rows, bool one_sided) {
  constexpr int kMost = 10;  // then the last set is kept, as if it were two-sided
  Mat6 k = Mat6::Zero();
  Vec6 f = Vec6::Zero(), xi = Vec6::Zero();
  const auto turn = [&](BodyRow& row, double pushes) {
    const Vec6 scaled = ((pushes - row.mu) / row.d) * row.q;
    k += scaled * row.q.transpose();
    f += row.c * scaled;
    row.mu = pushes;  // 1 or 0 until the set is found
  };
  for (BodyRow& row : rows) row.mu = 0;
  bool changed = true;
  for (int round = 0; changed && round < kMost; ++round) {
    changed = false;
    for (BodyRow& row : rows) {
      const double pushes = !one_sided || row.c > row.q.dot(xi) ? 1 : 0;
      if (pushes == row.mu) continue;
      turn(row, pushes);
      changed = true;
    }
    if (changed) xi = respond(w, k, f);
  }
  for (BodyRow& row : rows) row.mu *= (row.c - row.q.dot(xi)) / row.d;
  return xi;
}

template <class Real>
void YieldingBodies<Real>::begin(const Contact& contact, double m0, double dt, int dimension) {
  m0_ = m0, h_ = dt, planar_ = dimension == 2;
  bodies_.clear();
  starts_.clear();
  for (std::vector<std::size_t>& members : geometry::colliders_by_body(contact.colliders)) {
    const geometry::Collider& first = contact.colliders[members[0]];
    const Mat6 w = planar_ ? in_plane(first.body.mobility) : first.body.mobility;
    bodies_.push_back(
        {.colliders = std::move(members), .mobility = m0 * w, .base = first.body_velocity()});
  }
  if (bodies_.empty()) return;
  for (const geometry::Collider& c : contact.colliders) {
    starts_.push_back({c.position(), c.orientation()});
  }
}

template <class Real>
void YieldingBodies<Real>::note(std::span<std::vector<NearWall<Real>>> near) {
  std::vector<std::size_t> body_of(starts_.size(), bodies_.size());
  for (std::size_t b = 0; b < bodies_.size(); ++b) {
    for (const std::size_t c : bodies_[b].colliders) body_of[c] = b;
  }
  for (std::vector<NearWall<Real>>& chunk : near) {
    for (NearWall<Real>& entry : chunk) {
      const auto c = usize(entry.collider);
      if (c < body_of.size() && body_of[c] < bodies_.size()) {
        bodies_[body_of[c]].near.push_back(&entry);
      }
    }
  }
  std::int32_t last = -1;
  for (Body& body : bodies_) {
    if (body.colliders.size() > 1) {
      std::stable_sort(body.near.begin(), body.near.end(),
                       [](const auto* a, const auto* b) { return a->particle < b->particle; });
    }
    if (!body.near.empty()) last = std::max(last, body.near.back()->particle);
  }
  if (bodies_.size() < 2) return;
  pull_.assign(usize(last + 1), 0);
  std::vector<Body*> owner(usize(last + 1), nullptr);
  for (Body& body : bodies_) {
    for (const NearWall<Real>* entry : body.near) {
      Body*& other = owner[usize(entry->particle)];
      if (other != nullptr && other != &body) other->shares = body.shares = true;
      other = &body;
    }
  }
}

template <class Real>
void YieldingBodies<Real>::share(const Contact& contact, std::span<const Point<Real>> x,
                                 std::span<const DensityRow<Real>> density, bool one_sided,
                                 std::span<Point<Real>> multipliers) {
  constexpr int kRounds = 4;  // of Gauss and Seidel, over bodies that share particles
  set_rows(contact, x, [](std::int32_t, const Point<Real>& g) { return xyz(g); });
  std::fill(pull_.begin(), pull_.end(), 0);
  for (Body& body : bodies_) body.xi.setZero();
  for (int round = 0; round < kRounds; ++round) {
    for (Body& body : bodies_) {
      if (round > 0 && !body.shares) continue;
      for (BodyRow& row : body.rows) {
        const DensityRow<Real>& own = density[usize(row.particle)];
        row.c = own.violation, row.d = own.scale;
        if (body.shares) row.c -= pull_[usize(row.particle)] - row.q.dot(body.xi);
      }
      const Vec6 before = body.xi;
      body.xi = solve_rows(body.mobility, body.rows, one_sided);
      if (!body.shares) continue;
      for (const BodyRow& row : body.rows) {
        pull_[usize(row.particle)] += row.q.dot(body.xi - before);
      }
    }
  }
  for (const Body& body : bodies_) {
    for (const BodyRow& row : body.rows) {
      multipliers[usize(row.particle)].w = static_cast<Real>(-row.mu);
    }
  }
}

template <class Real>
void YieldingBodies<Real>::push(Contact& contact, std::span<const Point<Real>> multipliers,
                                std::span<const Point<Real>> x, std::span<const Real> mass) {
  for (Body& body : bodies_) {
    for (const NearWall<Real>* near : body.near) {
      const auto i = usize(near->particle);
      const double moved = double(x[i].w) * double(multipliers[i].w);
      if (moved == 0 || near->gradient.w == 0) continue;
      contact.add_push(usize(near->collider), near->particle, x[i],
                       contact.share * moved * xyz(near->gradient), mass_of(mass, near->particle));
    }
    follow(contact, body);
  }
}

template <class Real>
void YieldingBodies<Real>::meet(Contact& contact, std::span<const Point<Real>> start,
                                std::span<Point<Real>> x, std::span<const Real> mass) {
  constexpr std::int64_t kNear = 256;  // in a task
  for (Body& body : bodies_) {
    pushes_.resize(body.near.size());
    parallel_for(
        static_cast<std::int64_t>(body.near.size()), kNear,
        [&](std::int64_t begin, std::int64_t end) {
          for (auto k = usize(begin); k < usize(end); ++k) {
            const NearWall<Real>& near = *body.near[k];
            const auto i = usize(near.particle);
            pushes_[k] = contact.way_off(usize(near.collider), start[i], x[i]);
          }
        },
        contact.threads);
    body.rows.clear();
    for (std::size_t k = 0; k < body.near.size(); ++k) {
      const double length = pushes_[k].norm();
      if (length == 0) continue;
      const NearWall<Real>& near = *body.near[k];
      const Point<Real>& at = x[usize(near.particle)];
      body.rows.push_back({.particle = near.particle,
                           .collider = near.collider,
                           .q = wrench(arm(contact, body, at), -pushes_[k] / length),
                           .c = length,
                           .d = double(at.w)});
    }
    if (body.rows.empty()) continue;
    solve_rows(body.mobility, body.rows, true);
    for (const BodyRow& row : body.rows) {
      Point<Real>& at = x[usize(row.particle)];
      const Point<Real> before = at;
      const Vec3 to = xyz(at) - row.d * row.mu * row.q.head<3>();
      at.x = static_cast<Real>(to.x()), at.y = static_cast<Real>(to.y());
      at.z = static_cast<Real>(to.z());
      contact.add_push(usize(row.collider), row.particle, at,
                       contact.share * (xyz(at) - xyz(before)), mass_of(mass, row.particle));
    }
    follow(contact, body);
  }
}

// Adds what the body was given since the last time to its velocity; returns the change.
template <class Real>
Vec6 YieldingBodies<Real>::gather(Contact& contact, Body& body) const {
  Vec6 impulse = Vec6::Zero();
  for (const std::size_t c : body.colliders) {
    geometry::Collider& collider = contact.colliders[c];
    const geometry::Exchange given = contact.take(c);
    impulse += wrench(collider.position() - collider.centre(), given.impulse);
    impulse.tail<3>() += given.torque;
  }
  const Vec6 change = body.mobility * impulse / m0_;
  body.velocity += change;
  return change;
}

// And puts it where that leads.
template <class Real>
void YieldingBodies<Real>::follow(Contact& contact, Body& body) {
  const Vec6 change = gather(contact, body);
  if (change.isZero(0)) return;
  body.pace += change / contact.share;
  for (const std::size_t c : body.colliders) {
    geometry::Collider& collider = contact.colliders[c];
    collider.set_position(starts_[c].position);
    collider.set_orientation(starts_[c].orientation);
    collider.set_body_velocity(body.pace);
    collider.advance(h_);
    collider.set_body_velocity(body.velocity);
    contact.moved(c);
  }
}

template <class Real>
void YieldingBodies<Real>::accelerate(Contact& contact, double dt) {
  for (Body& body : bodies_) {
    const Vec6 change = dt * contact.colliders[body.colliders[0]].body.acceleration;
    body.base += change;
    body.velocity += change;
    for (const std::size_t c : body.colliders) {
      contact.colliders[c].set_body_velocity(body.velocity);
    }
  }
}

// With u the velocity of the body, t_i the change of a particle's: t_i(u) stops it against the
// surface, cut to friction times what pushed it. u = V - W sum_i m_i B_i^T t_i(u) by steps with
// all of them as if they stuck, which is more than the slope where some slide: so a step never
// overshoots. The last is taken as it is, without a cut.
template <class Real>
void YieldingBodies<Real>::rub(Contact& contact, std::span<const Point<Real>> x,
                               std::span<Point<Real>> v, std::span<const Real> mass) {
  constexpr int kSteps = 20;
  constexpr double kEnough = 1e-6;
  using Arms = Eigen::Matrix<double, 3, 6>;
  struct Rubbed {
    std::int32_t particle, collider;
    Arms b;  // motion of the body to that along the surface
    Vec3 way, change;
    double mass, most;
  };
  for (Body& body : bodies_) {
    gather(contact, body);
    std::vector<Rubbed> rubbed;
    Mat6 k = Mat6::Zero();
    for (const NearWall<Real>* near : body.near) {
      const double friction = contact.colliders[usize(near->collider)].friction;
      const Vec3 push =
          friction > 0 ? contact.pushed(usize(near->collider), near->particle) : Vec3(Vec3::Zero());
      const double size = push.norm(), m = mass_of(mass, near->particle) / m0_;
      if (size == 0) continue;
      const Vec3 n = push / size, r = arm(contact, body, x[usize(near->particle)]);
      geometry::Mat3 along = geometry::Mat3::Identity() - n * n.transpose();
      if (planar_) along.row(2).setZero();
      Arms b;
      b.leftCols<3>() = along;
      for (int axis = 0; axis < 3; ++axis) b.col(3 + axis) = along * Vec3::Unit(axis).cross(r);
      rubbed.push_back({near->particle, near->collider, b, along * xyz(v[usize(near->particle)]),
                        Vec3::Zero(), m, friction * size / h_});
      k += m * b.transpose() * b;
    }
    if (rubbed.empty()) continue;
    Vec6 u = body.velocity, step = Vec6::Zero();
    for (int round = 0; round < kSteps; ++round) {
      Vec6 given = Vec6::Zero();
      for (Rubbed& row : rubbed) {
        row.change = row.b * u - row.way;
        if (const double size = row.change.norm(); size > row.most) row.change *= row.most / size;
        given -= row.mass * row.b.transpose() * row.change;
      }
      const Vec6 lacking = body.velocity + body.mobility * given - u;
      step = (Mat6::Identity() + body.mobility * k).partialPivLu().solve(lacking);
      if (step.norm() <= kEnough * (u.norm() + step.norm())) break;
      if (round + 1 < kSteps) u += step;
    }
    for (const Rubbed& row : rubbed) {
      Point<Real>& to = v[usize(row.particle)];
      const Point<Real> before = to;
      const Vec3 after = xyz(to) + row.change + row.b * step;
      to.x = static_cast<Real>(after.x()), to.y = static_cast<Real>(after.y());
      to.z = static_cast<Real>(after.z());
      contact.add_impulse(usize(row.collider), x[usize(row.particle)],
                          -m0_ * row.mass * (xyz(to) - xyz(before)));
    }
  }
}

template <class Real>
void YieldingBodies<Real>::end(Contact& contact) {
  for (const Body& body : bodies_) {
    for (const std::size_t c : body.colliders) {
      contact.colliders[c].set_body_velocity(body.base);
    }
  }
  if (!bodies_.empty()) geometry::push_bodies(contact.colliders);
}

template class YieldingBodies<float>;
template class YieldingBodies<double>;

}  // namespace substep::pbf
