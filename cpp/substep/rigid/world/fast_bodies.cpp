#include "substep/rigid/world/fast_bodies.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "substep/core/quaternion.h"
#include "substep/core/usize.h"
#include "substep/rigid/distance/time_of_impact.h"

namespace substep::rigid {
namespace {

// Balls, of the inner radius: the first that does not begin inside of what it might meet.
constexpr double kBalls[] = {0.5, 0.25, 0.125};
constexpr double kAway = 0.1;  // of the ball: how far it stays away, at least, and at most twice

Course course_of(std::int32_t body, const Fixtures& fixtures, const Bodies& bodies) {
  Course course;
  course.body = fixtures.body_pose(body);
  if (bodies.motion[usize(body)] == Motion::kStatic) return course;
  const Pose end = bodies.pose(body);
  course.travel = end.position - course.body.position;
  course.turn = rotation_vector(Quaternion(end.rotation * course.body.rotation.transpose()));
  return course;
}

struct Stop {
  std::int32_t body;
  Course course;
  double part = 1;             // of its way that it can go
  Vec3 normal = Vec3::Zero();  // towards what stops it, unless that is free to move
};

// To what the middle of the fixture can go.
void shorten(std::int32_t f, const Fixtures& fixtures, const BroadPhase& broad_phase,
             const Bodies& bodies, Stop& stop) {
  Course course = stop.course;
  const Fixtures::Entry& entry = fixtures[f];
  course.local = entry.fixture.local;
  course.local.position = entry.fixture.local.to_world(entry.core.centre);
  const double radius = kBalls[0] * entry.core.radius;
  const Vec3 from = course.at(0).position, to = course.at(1).position;
  if (!((to - from).norm() > radius)) return;
  const Bounds box{from.cwiseMin(to).array() - 2 * radius, from.cwiseMax(to).array() + 2 * radius};
  for (const std::int32_t other : broad_phase.overlapping(box)) {
    // The broad phase still has others from where they were.
    if (!broad_phase.may_touch(f, other) || apart(box, fixtures.bounds()[usize(other)])) continue;
    Course others = course_of(fixtures[other].body, fixtures, bodies);
    others.local = fixtures[other].fixture.local;
    for (const double size : kBalls) {
      const double r = size * entry.core.radius;
      const Impact impact = time_of_impact(Sphere{r}, course, fixtures[other].fixture.shape, others,
                                           kAway * r, kAway * r);
      const bool touching = impact.state == Impact::State::kTouching;
      const bool free = bodies.dynamic(fixtures[other].body);
      // Two free ones that are in each other already must be able to part.
      if (impact.state == Impact::State::kOverlap || (touching && free && impact.time == 0))
        continue;
      if (touching && impact.time < stop.part) {
        stop.part = impact.time;
        stop.normal = free ? Vec3::Zero() : impact.normal;
      }
      break;
    }
  }
}

}  // namespace

void stop_fast_bodies(std::span<const std::int32_t> moved, const Fixtures& fixtures,
                      const BroadPhase& broad_phase, const Vec3& gravity, Bodies& bodies) {
  std::vector<Stop> stops;
  const auto meets_some = [&](std::int32_t body) {
    for (std::int32_t f = fixtures.first(body); f < fixtures.first(body + 1); ++f)
      if (fixtures[f].fixture.group != 0 && fixtures[f].fixture.mask != 0) return true;
    return false;
  };
  for (const std::int32_t body : moved) {
    if (!bodies.dynamic(body) || !meets_some(body)) continue;
    // No middle of a fixture goes further than this.
    const double way = (bodies.position(body) - fixtures.body_pose(body).position).norm() +
                       2 * fixtures.off_centre(body);
    if (!(way > kBalls[0] * fixtures.inner(body))) continue;
    Stop stop{body, course_of(body, fixtures, bodies)};
    for (std::int32_t f = fixtures.first(body); f < fixtures.first(body + 1); ++f)
      shorten(f, fixtures, broad_phase, bodies, stop);
    if (stop.part < 1) stops.push_back(stop);
  }
  for (const auto& [body, course, part, normal] : stops) {
    const auto b = usize(body);
    const Vec3 back = (part - 1) * course.travel;
    Vec3::Map(&bodies.x[3 * b]) += back;
    store_quaternion((rotation_by((part - 1) * course.turn) * bodies.rotation(body)).normalized(),
                     &bodies.q[4 * b]);
    // One that stands there from the start, as its contacts did not turn it back.
    const double into = bodies.velocity(body).dot(normal);
    if (part == 0 && into > 0) Vec3::Map(&bodies.P[3 * b]) -= bodies.mass[b] * into * normal;
    // v^2 / 2 - g . x may not become more.
    const double square = bodies.velocity(body).squaredNorm(), gain = -2 * gravity.dot(back);
    if (gain > 0 && square > 0)
      Vec3::Map(&bodies.P[3 * b]) *= std::sqrt(std::max(0.0, 1 - gain / square));
  }
}

}  // namespace substep::rigid
