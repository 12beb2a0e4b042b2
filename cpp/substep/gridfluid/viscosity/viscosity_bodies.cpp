// Bodies that yield to a viscous liquid: their velocities V are unknowns beside those of the faces,
// with the energy (V - V*) . W^-1 (V - V*) in masses of a full cell, or W J in place of V - V* for
// what cannot move in all ways. What the faces in a body and the rates of strain at its surface
// give of V makes the terms of BodyOfRows.
#include <Eigen/LU>
#include <algorithm>

#include "substep/core/usize.h"
#include "substep/gridfluid/pressure/bodies.h"
#include "substep/gridfluid/viscosity/viscosity.h"

namespace substep::gridfluid {

// The velocities of obstacles that a rate of strain is made of.
template <class Real, int D>
auto Viscosity<Real, D>::held_in(const Strain& strain) const -> std::vector<Held> {
  std::vector<Held> held;
  for (int t = 0; t < strain.count; ++t) {
    const Term& term = strain.terms[usize(t)];
    if (term.covered != 0) held.push_back({term.axis, term.face, term.covered});
    if (term.row != kObstacle) continue;
    held.push_back({term.axis, term.face, term.coefficient * (1 - term.inner)});
    if (term.inner == 0) continue;
    held.push_back({term.axis, strain.terms[usize(t ^ 1)].face, term.coefficient * term.inner});
  }
  return held;
}

template <class Real, int D>
void Viscosity<Real, D>::find_yielding(const Obstacles<Real, D>& obstacles) {
  yielding_.clear();
  const auto bodies = responding_bodies(obstacles.colliders);
  for (std::size_t k = 0; k < bodies.size(); ++k)
    for (const std::size_t c : bodies[k]) yielding_.push_back({c, k, {}});
  system_.bodies.resize(bodies.size());
}

// Sets the pushes of all that yields, and calls use(strain, motions) for each rate of strain with a
// part that is theirs: its derivatives by their velocities, of each that it has of.
template <class Real, int D>
template <class Use>
void Viscosity<Real, D>::for_pushes(const Obstacles<Real, D>& obstacles, const Velocity<Real, D>& u,
                                    const Use& use) {
  std::vector<std::size_t> place(obstacles.colliders.size(), yielding_.size());
  for (std::size_t k = 0; k < yielding_.size(); ++k) place[yielding_[k].collider] = k;
  // Which of them a face belongs to, and its derivative; none: all of them.
  const auto owner = [&](std::size_t axis, std::int64_t face) {
    const auto& near = obstacles.faces_near(static_cast<int>(axis));
    const auto at = std::lower_bound(near.begin(), near.end(), face,
                                     [](const auto& one, std::int64_t i) { return one.index < i; });
    return at == near.end() || at->index != face ? yielding_.size() : place[at->collider];
  };
  const auto motion_at = [&](std::size_t k, std::size_t axis, std::int64_t face) {
    const int a = static_cast<int>(axis);
    const Vec3 centre = obstacles.colliders[yielding_[k].collider].centre();
    return Motion(motion_of<D>(obstacles.middle(face, a) - centre, a));
  };
  for (Yields& one : yielding_) one.push.setZero();
  Motions motions;
  const auto add = [&](std::size_t axis, std::int64_t face, std::size_t a, std::size_t b,
                       const Place& at) {
    const Strain s = strain(obstacles, a, b, at);
    if (s.weight == 0) return;
    motions.clear();
    bool first = true;  // the first face of it is where it is looked at
    for (const Held& held : held_in(s)) {
      const std::size_t k = owner(held.axis, held.face);
      if (k == yielding_.size()) continue;
      if (first && (held.axis != axis || held.face != face)) return;
      first = false;
      const auto same = std::find_if(motions.begin(), motions.end(),
                                     [&](const auto& motion) { return motion.first == k; });
      const Motion more = held.coefficient * motion_at(k, held.axis, held.face);
      if (same == motions.end()) {
        motions.emplace_back(k, more);
      } else {
        same->second += more;
      }
    }
    if (motions.empty()) return;
    const double stress = s.weight * rate(s, u);
    for (const auto& [k, motion] : motions) yielding_[k].push -= stress * motion;
    use(s, motions);
  };
  for (std::size_t a = 0; a < D; ++a) {
    for (const auto& near : obstacles.faces_near(static_cast<int>(a))) {
      const std::size_t k = place[near.collider];
      const std::int64_t face = near.index;
      const std::int32_t row = row_[a][usize(face)];
      if (k == yielding_.size() || row == kNone || row == kWall) continue;
      for_strains(a, layout_.cell(face),
                  [&](std::size_t b, std::size_t c, const Place& at) { add(a, face, b, c, at); });
      const auto m = double(volumes_.of_face(a, face));
      if (row != kObstacle || m == 0) continue;
      const Motion motion = motion_at(k, a, face);
      yielding_[k].push += m * (double(u[a][usize(face)]) - theirs(obstacles, a, face)) * motion;
      use({.weight = m, .count = 0, .terms = {}}, {{k, motion}});
    }
  }
}

// To the system, and to its right side.
template <class Real, int D>
void Viscosity<Real, D>::add_bodies(const Obstacles<Real, D>& obstacles, const Velocity<Real, D>& u,
                                    double mass) {
  find_yielding(obstacles);
  if (yielding_.empty()) return;
  std::vector<Mobility> stiffness(system_.bodies.size(), Mobility::Zero());
  for_pushes(obstacles, u, [&](const Strain& s, const Motions& motions) {
    // Where several bodies are in one rate of strain, each is held by all of it: of (a + b)^2 <= 2
    // a^2 + 2 b^2, so that none of what couples them is left out that would make it more.
    const auto of_pair = static_cast<double>(motions.size());
    for (const auto& [k, motion] : motions) {
      const std::size_t body = yielding_[k].body;
      stiffness[body] += of_pair * s.weight * motion * motion.transpose();
      for (int t = 0; t < s.count; ++t) {
        const Term& term = s.terms[usize(t)];
        if (term.row >= 0)
          system_.bodies[body].k.emplace_back(term.row, s.weight * term.coefficient * motion);
      }
    }
  });
  for (BodyOfRows<D>& body : system_.bodies) body.join();
  std::vector<Motion> pushes(system_.bodies.size(), Motion::Zero());
  for (const Yields& one : yielding_) {
    pushes[one.body] += one.push;
    const std::size_t k = one.body;
    const auto& mobility = obstacles.colliders[one.collider].body.mobility;
    const Mobility w = mass * mobility(kMotionPlaces<D>, kMotionPlaces<D>);
    const Mobility c = (Mobility::Identity() + w * stiffness[k]).partialPivLu().solve(w);
    system_.bodies[k].c = 0.5 * (c + c.transpose());
  }
  for (std::size_t k = 0; k < pushes.size(); ++k) {
    BodyOfRows<D>& body = system_.bodies[k];
    body.g = pushes[k];
    body.subtract(body.c * body.g, b_);
  }
}

// By the velocities of the faces that were found; then what the liquid pushes them with.
template <class Real, int D>
void Viscosity<Real, D>::move_bodies(Obstacles<Real, D>& obstacles, const Velocity<Real, D>& u,
                                     int threads) {
  if (yielding_.empty()) return;
  for (const Yields& one : yielding_) {
    const BodyOfRows<D>& body = system_.bodies[one.body];
    geometry::Collider& collider = obstacles.colliders[one.collider];
    geometry::Vec6 v = collider.body_velocity();
    v(kMotionPlaces<D>) += body.c * (body.g - body.product(x_));
    collider.set_body_velocity(v);
  }
  obstacles.find(threads);
  for_pushes(obstacles, u, [](const Strain&, const Motions&) {});
}

template class Viscosity<float, 2>;
template class Viscosity<float, 3>;
template class Viscosity<double, 2>;
template class Viscosity<double, 3>;

}  // namespace substep::gridfluid
