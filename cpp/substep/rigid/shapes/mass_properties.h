// Mass, centre and inertia of solids of uniform density.
//
// Moments are sums over the parts of a body once they are about one point (moved, sum); the body's
// own frame is the principal one (principal). Lengths in m, density in kg/m^3.
#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "substep/core/quaternion.h"
#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid {

// The frame at the centre along `axes` (of the body into the frame) in which inertia is diagonal.
struct MassProperties {
  double mass;
  Vec3 centre;
  Quaternion axes;
  Vec3 inertia;
};

// In the frame of the shape. InputError: a density or a length is not above 0; it has no volume (a
// plane or a mesh; for a closed one see below).
MassMoments moments(const Shape& shape, double density);

// Integrals over the solid that triangles bound, counter-clockwise seen from outside: signed sums
// over the tetrahedra between them and one point. Exact for polyhedra. Mirtich 1996, "Fast and
// accurate computation of polyhedral mass properties", J. Graph. Tools 1(2); the sums over corners
// as in Eberly 2002, "Polyhedral mass properties (revisited)", with the products of corners
// gathered.
class SolidIntegrals {
 public:
  // Any point will do; one close to the solid keeps digits.
  explicit SolidIntegrals(const Vec3& origin) : origin_(origin) {}
  void add(const Vec3& a, const Vec3& b, const Vec3& c);
  double volume() const { return volume_ / 6; }
  MassMoments moments(double density) const;

 private:
  Vec3 origin_;
  double volume_ = 0;           // 6 int dV
  Vec3 first_ = Vec3::Zero();   // 24 int x dV
  Mat3 second_ = Mat3::Zero();  // 120 int x x^T dV
};

// Of the solid that a closed mesh bounds: vertices (n, 3), faces (m, 3). It may be hollow or
// consist of several parts. InputError: an index is out of range or a face has a vertex twice; an
// edge is not shared by as many faces of either direction (an open mesh, faces that look to
// different sides); the faces look inward as a whole, or there is no volume. Of a mesh that cuts
// itself the parts inside of it twice count twice.
MassMoments moments(std::span<const double> vertices, std::span<const std::int64_t> faces,
                    double density);

// Of the same solid placed at `pose` in another frame.
MassMoments moved(const MassMoments& solid, const Pose& pose);
// Of all parts together, about their common centre: Huygens and Steiner's parallel axes.
MassMoments sum(std::span<const MassMoments> parts);

// Of a body of several fixtures, each with its density. InputError as above.
MassMoments moments(std::span<const Fixture> fixtures);

// The principal frame, of all its 24 turns and permutations the one nearest to the frame of the
// moments: for a diagonal inertia it is that frame. Moments that differ by rounding are equal, so
// that a cube or a sphere keeps its axes. InputError: not finite, not symmetric, mass not above 0,
// a principal moment not above 0, or greater than the sum of the other two.
MassProperties principal(const MassMoments& solid);

// What principal moments must fulfil, the last two of the above; `name` is what the message calls
// them.
void check_principal_moments(const Vec3& inertia, const char* name);

}  // namespace substep::rigid
