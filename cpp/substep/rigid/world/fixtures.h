// The shapes of all bodies of a world: what each is made of and where it is in this step.
//
// A fixture's bounds hold it throughout the step and as far around as contacts are looked for, so
// two fixtures whose bounds are apart have none.
#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "substep/core/usize.h"
#include "substep/rigid/motion/bodies.h"
#include "substep/rigid/shapes/shapes.h"
#include "substep/rigid/world/material_pairs.h"

namespace substep::rigid {

// InputError, with the number of the fixture: a length, density, friction or restitution is out of
// range, the pose is none, or a body that moves has a plane or a mesh.
void check_fixtures(std::span<const Fixture> fixtures, Motion motion);

// The body whose fixtures are given in a frame of their own, which is at `frame.position` and
// turned by `frame.rotation`: its mass and moments by the densities, its centre and principal axes,
// in whose frame the fixtures are afterwards. InputError as moments() and principal().
BodyState assemble(const BodyState& frame, std::span<Fixture> fixtures);

// What holds between two surfaces.
struct Surface {
  double friction, static_friction, restitution, rolling, spinning;
};

// How the body of a fixture goes on in a step.
struct Way {
  Vec3 travel = Vec3::Zero();  // of its centre [m]
  Vec3 turn = Vec3::Zero();    // rotation vector [rad]
  double angle = 0;            // its length
};

class Fixtures {
 public:
  struct Entry {
    Fixture fixture;
    std::int32_t body;
    Ball core;      // inner_ball()
    double outer;   // outer_radius()
    double margin;  // distance at which contacts begin [m]
  };

  std::int32_t size() const { return static_cast<std::int32_t>(entries_.size()); }
  const Entry& operator[](std::int32_t f) const { return entries_[usize(f)]; }
  // Fixtures of body b: numbers from first(b) to first(b + 1).
  std::int32_t first(std::int64_t b) const { return first_[usize(b)]; }
  // The largest distance of a point of the body from its centre [m].
  double outer(std::int64_t b) const { return sizes_[usize(b)].outer; }
  // The least radius of its cores, and the largest distance of one from its centre [m].
  double inner(std::int64_t b) const { return sizes_[usize(b)].inner; }
  double off_centre(std::int64_t b) const { return sizes_[usize(b)].off_centre; }

  // Appends a body with these fixtures; contacts begin at `margin` or a tenth of the inner radius.
  void add(std::span<const Fixture> fixtures, double margin);
  void remove_last_body();
  void make_room(std::size_t bodies, std::size_t fixtures);  // so that adding takes no memory
  // bodies[b]: the new number of body b, ascending, -1 if removed. Returns those of the fixtures.
  std::vector<std::int32_t> renumber(std::span<const std::int64_t> bodies);

  void set_material_pair(const MaterialPair& pair) { material_pairs_.set(pair); }
  const MaterialPairs& material_pairs() const { return material_pairs_; }
  // Between two of them: as their materials say, or else by the rule of world.h.
  Surface surface(const Fixture& a, const Fixture& b) const;
  double restitution(const Fixture& a, const Fixture& b) const;

  // Puts the fixtures of the body where it is, with bounds for its way in the step.
  void place(std::int64_t b, const Pose& pose, const Way& way);
  const Pose& pose(std::int32_t f) const { return pose_[usize(f)]; }
  const Pose& body_pose(std::int64_t b) const { return body_pose_[usize(b)]; }
  std::span<const Bounds> bounds() const { return bounds_; }

 private:
  struct Size {
    double outer = 0, inner = std::numeric_limits<double>::infinity(), off_centre = 0;
  };

  MaterialPairs material_pairs_;
  std::vector<Entry> entries_;
  std::vector<std::int32_t> first_{0};
  std::vector<Size> sizes_;             // of each body
  std::vector<Pose> pose_, body_pose_;  // in the world
  std::vector<Bounds> bounds_;
};

}  // namespace substep::rigid
