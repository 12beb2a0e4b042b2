// Contacts of spheres, capsules and planes in lanes against the narrow phase, one by one.
#include "substep/rigid/solver/round_contacts.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "shapes.h"
#include "substep/rigid/collision/narrow_phase.h"

namespace {

using namespace substep;
using namespace substep::rigid;
using test::Random;

constexpr int kLanes = ContactPacket::kLanes;
constexpr double kMargin = 100;

RoundShape round_shape(const Shape& shape, const Pose& pose) {
  if (const auto* sphere = std::get_if<Sphere>(&shape))
    return {pose.position, Vec3::Zero(), sphere->radius, false};
  if (const auto* capsule = std::get_if<Capsule>(&shape))
    return {pose.position, capsule->half_length * pose.rotation.col(2), capsule->radius, false};
  const Plane& plane = std::get<Plane>(shape);
  const Vec3 n = pose.rotation * plane.normal;
  return {pose.position + plane.offset * n, n, 0, true};
}

// As many pairs as a packet has lanes: shapes on two bodies each, and their contacts.
struct Pairs {
  std::vector<Shape> a, b;
  std::vector<Pose> local_a, local_b;
  std::vector<ContactConstraint> contacts;
  Bodies bodies;
  BodyRows rows;
  ContactPacket packet;
  RoundContacts round;

  std::int32_t add_body(Random& random, const Shape& shape) {
    BodyState body;
    const Quaternion q(random.number(-1, 1), random.number(-1, 1), random.number(-1, 1), 0.5);
    body.position = random.vector(1), body.rotation = q.normalized();
    body.motion = is_ground(shape) ? Motion::kStatic : Motion::kDynamic;
    body.inertia = {1, 1.2, 1.5};
    return static_cast<std::int32_t>(bodies.add(body));
  }
  Manifold collide_now(std::size_t k, const Pose& body_a, const Pose& body_b) const {
    Manifold manifold;
    Cache cache;
    collide(a[k], body_a * local_a[k], b[k], body_b * local_b[k], kMargin, manifold, cache);
    return manifold;
  }
  // All points press, so that all go on.
  void add(Random& random, const Shape& one, const Shape& other, const Pose& local) {
    a.push_back(one), b.push_back(other);
    local_a.push_back(local), local_b.push_back(random.pose(0.3));
    const std::int32_t i = add_body(random, one), j = add_body(random, other);
    contacts.push_back(make_contact(collide_now(a.size() - 1, bodies.pose(i), bodies.pose(j)), i,
                                    bodies.pose(i), j, bodies.pose(j), acts(a.size() - 1)));
    contacts.back().margin = kMargin;
    for (auto& point : contacts.back().points) point.impulse = 1;
  }
  double acts(std::size_t k) const { return is_ground(a[k]) ? 1 : is_ground(b[k]) ? 0 : 0.5; }

  void pack() {
    const ContactConstraint* of[kLanes] = {};
    bool all[kLanes];
    std::fill_n(all, kLanes, true);
    for (std::size_t k = 0; k < contacts.size(); ++k) of[k] = &contacts[k];
    packet.set(of, all, rows);
    packet.prepare(rows);
  }

  // Bodies go on and turn, and contacts are found in lanes.
  void find(Random& random) {
    rows.load(bodies, Vec3::Zero(), {}, 1);
    pack();
    round.clear();
    for (std::size_t k = 0; k < contacts.size(); ++k) {
      const ContactConstraint& c = contacts[k];
      round.add(static_cast<int>(k),
                {round_shape(a[k], bodies.pose(c.a) * local_a[k]),
                 round_shape(b[k], bodies.pose(c.b) * local_b[k]), acts(k)},
                c, bodies);
    }
    for (std::size_t row = 1; row < usize(rows.size()); ++row) {
      const Vec3 x = random.vector(0.1), w = random.vector(0.2);
      rows.displacement[row] = {{x[0], x[1], x[2], 0}, {w[0], w[1], w[2], 0}};
    }
    round.find(rows, 0.01, packet);
    bool all[kLanes];
    std::fill(all, all + kLanes, true);
    packet.prepare(rows);
    packet.rebase(rows, all);
    round.finish(rows, packet);
  }
};

TEST(RigidRoundContacts, AreThoseOfTheNarrowPhase) {
  Random random(1);
  const auto shape = [&](int kind) -> Shape {
    if (kind == 0) return Sphere{random.number(0.2, 1)};
    if (kind == 1) return Capsule{random.number(0.2, 1), random.number(0.2, 1)};
    return Plane{random.direction(), random.number(-1, 1)};
  };
  int found = 0;
  for (int round = 0; round < 2000; ++round) {
    Pairs pairs;
    for (int lane = 0; lane < kLanes; ++lane) {
      const int kind = (round * kLanes + lane) % 8;
      pairs.add(random, shape(kind / 3), shape(kind % 3), random.pose(0.3));
    }
    pairs.find(random);
    for (std::size_t k = 0; k < usize(kLanes); ++k) {
      const auto lane = static_cast<int>(k);
      ContactConstraint c = pairs.contacts[k];
      const Pose pose_a = pairs.rows.pose(pairs.bodies, c.a),
                 pose_b = pairs.rows.pose(pairs.bodies, c.b);
      if (!pairs.round.has(lane)) continue;
      ++found;
      pairs.round.report(lane, pairs.packet, c);
      const ContactConstraint d = make_contact(pairs.collide_now(k, pose_a, pose_b), c.a, pose_a,
                                               c.b, pose_b, pairs.acts(k));
      ASSERT_EQ(c.count, d.count);
      EXPECT_LT((c.normal - d.normal).norm(), 1e-12);
      EXPECT_LT(std::abs(c.tangent.dot(c.normal)) + std::abs(c.tangent.norm() - 1), 1e-12);
      const ContactConstraint& old = pairs.contacts[k];
      const double left = (old.tangent - old.tangent.dot(c.normal) * c.normal).squaredNorm();
      if (std::abs(left - RoundContacts::kSameTangent) < 1e-9) continue;
      const int kept = left > RoundContacts::kSameTangent ? 1 : 0;
      double pressing = 0;
      for (int i = 0; i < c.count; ++i) {
        const auto &p = c.points[i], &q = d.points[i];
        EXPECT_NEAR(p.separation, q.separation, 1e-6);  // float32 in a packet
        EXPECT_LT((p.position - q.position).norm(), 1e-12);
        EXPECT_LT((p.in_a - q.in_a).norm() + (p.in_b - q.in_b).norm(), 1e-12);
        EXPECT_LT((p.arm_a - q.arm_a).norm() + (p.arm_b - q.arm_b).norm(), 1e-12);
        if (c.count == old.count) {
          EXPECT_EQ(p.impulse, kept);
        }
        pressing += p.impulse;
        const double along =
            p.arm_b.dot(c.tangent) - c.middle(&ContactConstraint::Point::arm_b).dot(c.tangent);
        EXPECT_NEAR(pairs.packet.p[i][lane], along, 1e-6);
      }
      EXPECT_EQ(pressing, kept * old.count);
    }
  }
  EXPECT_GT(found, 1900 * kLanes);
}

TEST(RigidRoundContacts, ParallelCapsulesAreLeftToTheNarrowPhase) {
  Random random(2);
  Pairs pairs;
  const Capsule capsule{0.2, 0.5};
  pairs.add(random, capsule, capsule, {});
  pairs.add(random, Sphere{0.2}, capsule, {});
  const Pose a = pairs.bodies.pose(pairs.contacts[0].a), b = pairs.bodies.pose(pairs.contacts[0].b);
  pairs.local_b[0] = Pose(a.position + Vec3(a.rotation.col(0)), a.rotation).relative_to(b);
  for (int lane = 0; lane < 2; ++lane) pairs.contacts[usize(lane)].margin = kMargin;
  // Without displacements.
  pairs.rows.load(pairs.bodies, Vec3::Zero(), {}, 1);
  pairs.pack();
  pairs.round.clear();
  for (std::size_t k = 0; k < 2; ++k) {
    const ContactConstraint& c = pairs.contacts[k];
    pairs.round.add(static_cast<int>(k),
                    {round_shape(pairs.a[k], pairs.bodies.pose(c.a) * pairs.local_a[k]),
                     round_shape(pairs.b[k], pairs.bodies.pose(c.b) * pairs.local_b[k]), 0.5},
                    c, pairs.bodies);
  }
  pairs.round.find(pairs.rows, 0.01, pairs.packet);
  EXPECT_TRUE(pairs.round.left(0));
  EXPECT_FALSE(pairs.round.has(0));
  EXPECT_FALSE(pairs.round.left(1));
  EXPECT_TRUE(pairs.round.has(1));
}

}  // namespace
