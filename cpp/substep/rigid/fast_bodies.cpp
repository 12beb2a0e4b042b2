#include "substep/rigid/fast_bodies.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "substep/core/quaternion.h"
#include "substep/rigid/time_of_impact.h"

namespace substep::rigid {
namespace {

constexpr double kBall = 0.5;        // of the inner radius
constexpr double kTolerance = 1e-3;  // of the ball

Course course_of(std::int32_t body, const Fixtures& fixtures, const Bodies& bodies) {
  Course course;
  course.body = fixtures.body_pose(body);
  if (bodies.motion[static_cast<std::size_t>(body)] == Motion::kStatic) return course;
  const Pose end = bodies.pose(body);
  course.travel = end.position - course.body.position;
  course.turn = rotation_vector(Quaternion(end.rotation * course.body.rotation.transpose()));
  return course;
}

// The part of its way that the middle of the fixture can go.
double free_part(std::int32_t f, Course course, const Fixtures& fixtures,
                 const BroadPhase& broad_phase, const Bodies& bodies) {
  const Fixtures::Entry& entry = fixtures[f];
  course.local = entry.fixture.local;
  course.local.position = entry.fixture.local.to_world(entry.core.centre);
  const double radius = kBall * entry.core.radius;
  const Vec3 from = course.at(0).position, to = course.at(1).position;
  if (!((to - from).norm() > radius)) return 1;
  double part = 1;
  const Bounds box{from.cwiseMin(to).array() - radius, from.cwiseMax(to).array() + radius};
  for (const std::int32_t other : broad_phase.overlapping(box)) {
    if (!broad_phase.may_touch(f, other)) continue;
    Course others = course_of(fixtures[other].body, fixtures, bodies);
    others.local = fixtures[other].fixture.local;
    const Impact impact = time_of_impact(Sphere{radius}, course, fixtures[other].fixture.shape,
                                         others, 0, kTolerance * radius);
    if (impact.state == Impact::State::kTouching) part = std::min(part, impact.time);
  }
  return part;
}

struct Stop {
  std::int32_t body;
  Course course;
  double part;
};

}  // namespace

void stop_fast_bodies(std::span<const std::int32_t> moved, const Fixtures& fixtures,
                      const BroadPhase& broad_phase, const Vec3& gravity, Bodies& bodies) {
  std::vector<Stop> stops;
  for (const std::int32_t body : moved) {
    if (!bodies.dynamic(body)) continue;
    // No middle of a fixture goes further than this.
    const double way = (bodies.position(body) - fixtures.body_pose(body).position).norm() +
                       2 * fixtures.off_centre(body);
    if (!(way > kBall * fixtures.inner(body))) continue;
    Stop stop{body, course_of(body, fixtures, bodies), 1};
    for (std::int32_t f = fixtures.first(body); f < fixtures.first(body + 1); ++f)
      stop.part = std::min(stop.part, free_part(f, stop.course, fixtures, broad_phase, bodies));
    if (stop.part < 1) stops.push_back(stop);
  }
  for (const auto& [body, course, part] : stops) {
    const auto b = static_cast<std::size_t>(body);
    const Vec3 back = (part - 1) * course.travel;
    Vec3::Map(&bodies.x[3 * b]) += back;
    store_quaternion((rotation_by((part - 1) * course.turn) * bodies.rotation(body)).normalized(),
                     &bodies.q[4 * b]);
    // v^2 / 2 - g . x may not become more.
    const double square = bodies.velocity(body).squaredNorm(), gain = -2 * gravity.dot(back);
    if (gain > 0) Vec3::Map(&bodies.P[3 * b]) *= std::sqrt(std::max(0.0, 1 - gain / square));
  }
}

}  // namespace substep::rigid
