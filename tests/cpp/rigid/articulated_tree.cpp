// Trees of joints in the coordinates of the joints: their linear algebra, and that their motion is
// the one that equations of each joint give.
#include "substep/rigid/solver/articulated_tree.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "joint_scene.h"
#include "substep/core/usize.h"

namespace {

using substep::rotation_by;
using substep::usize;

using namespace substep::rigid;
using Tree = ArticulatedTree;

Quad3 random_vector(std::mt19937& random, double size = 1) {
  std::uniform_real_distribution<double> uniform(-size, size);
  const double x = uniform(random), y = uniform(random), z = uniform(random);
  return quad(x, y, z);
}

// A free body or one at a hinge or a ball of the world, and seven at each other.
Tree random_tree(Tree::Kind root, std::mt19937& random) {
  constexpr Tree::Kind kKinds[] = {Tree::Kind::kHinge, Tree::Kind::kBall, Tree::Kind::kSlider,
                                   Tree::Kind::kFixed};
  std::vector<Tree::Part> parts;
  for (int k = 0; k < 8; ++k) {
    Tree::Part part;
    part.kind = k == 0 ? root : kKinds[k % 4];
    part.parent = k == 0 ? -1 : (k - 1) / 2;
    part.inertia = Quad3{0.2 + 0.1 * k, 0.3, 0.25, 1. + k % 3};
    part.seen_inertia = part.inertia;
    if (part.kind != Tree::Kind::kFree) {
      part.anchor = random_vector(random);
      part.centre = random_vector(random);
    }
    part.axis = quad(0, 0, 1);
    part.turning = {QuadMatrix{quad(0, 0, 0), quad(0, 0, 0), quad(0, 0, 1)},
                    QuadMatrix{quad(1, 0, 0), quad(0, 1, 0), quad(0, 0, 0)},
                    QuadMatrix{quad(0, 1, 0), quad(-1, 0, 0), quad(0, 0, 0)}};
    if (part.kind == Tree::Kind::kFixed || part.kind == Tree::Kind::kSlider)
      part.turning[0] = QuadMatrix::identity();
    parts.push_back(part);
  }
  return Tree(parts);
}

std::vector<Tree::Coordinate> random_coordinates(const Tree& tree, std::mt19937& random) {
  std::vector<Tree::Coordinate> coordinates(tree.size());
  for (Tree::Coordinate& at : coordinates) {
    const Quad3 v = random_vector(random);
    at.cosine = std::cos(3 * v[0]), at.sine = std::sin(3 * v[0]);
    at.q = Quaternion(1, v[0], v[1], v[2]).normalized();
    at.x = v;
    at.way = v[1];
  }
  return coordinates;
}

TEST(ArticulatedTree, LeavesNothingThatJointsCannotGive) {
  std::mt19937 random(1);
  for (const Tree::Kind root :
       {Tree::Kind::kFree, Tree::Kind::kHinge, Tree::Kind::kSlider, Tree::Kind::kBall}) {
    Tree tree = random_tree(root, random);
    const std::size_t n = tree.size();
    std::vector<Tree::Place> places(n);
    tree.place(random_coordinates(tree, random), places);
    tree.factor(places);
    const auto respond = [&](std::vector<Tree::Momentum>& wanted) {
      std::vector<Tree::Rate> rates(n);
      for (Tree::Momentum& m : wanted) m = {random_vector(random), random_vector(random)};
      tree.respond(wanted, rates);
      return rates;
    };
    std::vector<Tree::Momentum> wanted(n), other(n);
    const auto rates = respond(wanted), virtual_rates = respond(other);
    double work = 0, size = 0;
    for (std::size_t k = 0; k < n; ++k) {
      const Tree::Momentum has = tree.momentum(k, rates[k]);
      const Tree::Rate& way = virtual_rates[k];
      const Quad3 centre = way.linear + cross(way.angular, places[k].c);
      work += dot(wanted[k].linear - has.linear, centre) +
              dot(wanted[k].angular - has.angular, way.angular);
      size +=
          std::abs(dot(wanted[k].linear, centre)) + std::abs(dot(wanted[k].angular, way.angular));
      if (tree.parts()[k].parent < 0) continue;
      // The joint holds: its anchor moves with the parent.
      const Tree::Rate& parent = rates[usize(tree.parts()[k].parent)];
      Quad3 gap = rates[k].linear - parent.linear - cross(parent.angular, places[k].d);
      if (tree.parts()[k].kind == Tree::Kind::kSlider) gap -= rates[k].along * places[k].axis;
      EXPECT_LT(std::sqrt(dot(gap, gap)), 1e-13);
    }
    EXPECT_LT(std::abs(work), 1e-13 * size);
  }
}

// With a stiffness the same as with that inertia about the axis; and what holds a coordinate gives
// the impulse with which it moves as told.
TEST(ArticulatedTree, DrivesActAlongCoordinates) {
  std::mt19937 random(3);
  Tree tree = random_tree(Tree::Kind::kFree, random);
  const std::size_t n = tree.size();
  std::vector<Tree::Place> places(n);
  tree.place(random_coordinates(tree, random), places);
  std::vector<Tree::Momentum> wanted(n);
  for (Tree::Momentum& m : wanted) m = {random_vector(random), random_vector(random)};
  std::vector<Tree::Rate> held(n), pushed(n), stiff(n);
  const auto respond = [&](std::vector<Tree::Rate>& rates) {
    tree.factor(places);
    tree.respond(wanted, rates);
  };
  const auto driven = [&](const auto& task) {
    for (std::size_t k = 0; k < n; ++k)
      if (const auto kind = tree.parts()[k].kind;
          kind == Tree::Kind::kHinge || kind == Tree::Kind::kSlider)
        task(k);
  };
  driven([&](std::size_t k) {
    tree.drive(k) = {.held = true, .change = 0.1 * static_cast<double>(k)};
  });
  respond(held);
  driven([&](std::size_t k) { EXPECT_EQ(held[k].along, 0.1 * static_cast<double>(k)); });
  driven([&](std::size_t k) { tree.drive(k) = {.impulse = tree.impulse(k)}; });
  respond(pushed);
  const auto expect_same = [&](const auto& a, const auto& b) {
    for (std::size_t k = 0; k < n; ++k) {
      const Quad3 v = a[k].linear - b[k].linear, w = a[k].angular - b[k].angular;
      EXPECT_LT(dot(v, v) + dot(w, w), 1e-22);
    }
  };
  expect_same(held, pushed);
  driven([&](std::size_t k) {
    const double impulse = tree.impulse(k);
    tree.drive(k) = {.impulse = impulse + 3 * pushed[k].along, .stiffness = 3};
  });
  respond(stiff);
  expect_same(held, stiff);
}

// By differences: what momenta change by with the end of a motion, as motions free at its begin see
// it, is what the matrix says but for the square of the turn.
TEST(ArticulatedTree, HasTheDerivativeOfAMotionToSecondOrder) {
  std::mt19937 random(2);
  for (const Tree::Kind root :
       {Tree::Kind::kFree, Tree::Kind::kHinge, Tree::Kind::kSlider, Tree::Kind::kBall}) {
    Tree tree = random_tree(root, random);
    const std::size_t n = tree.size();
    const auto begin = random_coordinates(tree, random);
    std::vector<Tree::Place> now(n), then(n);
    tree.place(begin, now);
    tree.begin(now);
    const auto respond = [&](std::vector<Tree::Momentum>& wanted) {
      std::vector<Tree::Rate> rates(n);
      for (Tree::Momentum& m : wanted) m = {random_vector(random), random_vector(random)};
      tree.respond(wanted, rates);
      return rates;
    };
    tree.factor(now);
    std::vector<Tree::Momentum> wanted(n), found(n), low(n), high(n);
    const auto way = respond(wanted);
    std::vector<std::vector<Tree::Rate>> free;
    for (int k = 0; k < 6; ++k) free.push_back(respond(wanted));
    double most = 0, last = 0;
    for (const Tree::Rate& rate : way) most = std::max(most, dot(rate.angular, rate.angular));
    for (Tree::Momentum& m : wanted) m = {random_vector(random), random_vector(random)};
    for (const double turn : {0.08, 0.04, 0.02}) {
      constexpr double kStep = 1, kLittle = 1e-5;
      auto end = begin;
      tree.advance(way, turn / std::sqrt(most), end);
      const auto find = [&](const auto& coordinates, std::vector<Tree::Momentum>& momenta) {
        tree.place(coordinates, then);
        tree.find_momenta(then, kStep, momenta);
      };
      find(end, found);
      tree.factor(now, then, kStep, found);
      std::vector<Tree::Rate> rates(n);
      tree.respond(wanted, rates);
      auto before = end, after = end;
      tree.advance(rates, -kLittle, before), tree.advance(rates, kLittle, after);
      find(before, low), find(after, high);
      double off = 0, size = 0;
      for (const auto& rate : free) {
        double work = 0;
        for (std::size_t k = 0; k < n; ++k) {
          const Quad3 centre = rate[k].linear + cross(rate[k].angular, now[k].c);
          const double scale = 0.5 / kLittle;
          work +=
              dot(wanted[k].linear - scale * (high[k].linear - low[k].linear), centre) +
              dot(wanted[k].angular - scale * (high[k].angular - low[k].angular), rate[k].angular);
          size += std::abs(dot(wanted[k].linear, centre));
        }
        off = std::max(off, std::abs(work));
      }
      EXPECT_LT(off, 0.1 * turn * turn * size);
      if (last > 0) {
        EXPECT_NEAR(last / off, 4, 0.8);
      }
      last = off;
    }
  }
}

TEST(ArticulatedTree, HasTheMomentaOfASteadyTurn) {
  // Of one body about a principal axis: L = I w and P = m v, at any angle in the step.
  for (const double angle : {1e-6, 0.05, 0.2, 1., 2.}) {
    Tree::Part part;
    part.inertia = part.seen_inertia = Quad3{0.3, 0.4, 0.5, 2};
    Tree tree({part});
    std::vector<Tree::Coordinate> begin(1), end(1);
    begin[0].q = end[0].q = Quaternion::Identity();
    end[0].q = rotation_by({0, angle, 0});
    end[0].x = quad(0.1, 0, 0);
    std::vector<Tree::Place> from(1), to(1);
    tree.place(begin, from), tree.place(end, to);
    std::vector<Tree::Momentum> momenta(1);
    std::vector<Quad3> turns(1);
    tree.begin(from);
    tree.find_momenta(to, 0.01, momenta);
    tree.find_turns(to, turns);
    EXPECT_NEAR(momenta[0].angular[1], 0.4 * angle / 0.01, 1e-12 * angle / 0.01);
    EXPECT_NEAR(momenta[0].linear[0], 20, 1e-12);
    EXPECT_NEAR(turns[0][1], angle, 1e-14);
  }
}

// A tree of all its kinds of joints that is thrown, or hangs.
JointScene thrown(bool grounded, FreeRotation method, int substeps) {
  JointScene scene;
  scene.options.rotation = method;
  scene.options.substeps = substeps;
  for (int k = 0; k < 6; ++k)
    scene.add_box({0.05, 0.08, 0.2}, {0.1 * k, 0, -0.4 * k}, 1 + 0.5 * (k % 2));
  const auto between = [](int k) { return Vec3(0.1 * k - 0.05, 0.01, -0.4 * k + 0.2); };
  scene.add(make_ball(scene.bodies, 1, 0, between(1)));
  scene.add(make_hinge(scene.bodies, 1, 2, between(2), {0.2, 1, 0}));
  scene.add(make_fixed(scene.bodies, 3, 2, between(3)));
  scene.add(make_hinge(scene.bodies, 4, 3, between(4), {1, 0.3, 0}));
  scene.add(make_ball(scene.bodies, 4, 5, between(5)));
  if (grounded) {
    scene.add(make_hinge(scene.bodies, 0, -1, {0, 0, 0.2}, Vec3::UnitY()));
  } else {
    for (int k = 0; k < 6; ++k) scene.bodies.set_velocity(k, {0, 0.3 * k, 1});
  }
  scene.bodies.apply_impulse(5, {0.5, 0.8, 0}, scene.bodies.position(5));
  return scene;
}

TEST(ArticulatedTree, MovesAsEquationsOfEachJointSay) {
  for (const bool grounded : {false, true}) {
    double last = 0;
    for (const int substeps : {8, 16, 32}) {
      JointScene tree = thrown(grounded, FreeRotation::kSplitting, substeps);
      JointScene general = thrown(grounded, FreeRotation::kExact, substeps);  // has no trees
      double far = 0;
      for (int k = 0; k < 60; ++k) {
        tree.step(1. / 60), general.step(1. / 60);
        for (int b = 0; b < 6; ++b)
          far = std::max(far, (tree.bodies.position(b) - general.bodies.position(b)).norm());
      }
      EXPECT_EQ(tree.length_error, 0);
      EXPECT_GT(far, 1e-9);
      EXPECT_LT(far, 1e-2);
      if (last > 0) {
        EXPECT_NEAR(last / far, 4, 0.8);  // both are of second order
      }
      last = far;
    }
  }
}

TEST(ArticulatedTree, KeepsMomentumAndEnergy) {
  JointScene scene = thrown(false, FreeRotation::kSplitting, 8);
  scene.gravity.setZero();
  scene.step(1. / 60);  // joints take what they must of the velocities given
  const Vec3 P = scene.bodies.momentum(), L = scene.bodies.angular_momentum();
  const double energy = scene.energy();
  double off = 0;
  for (int k = 0; k < 1200; ++k) {
    scene.step(1. / 60);
    off = std::max(off, std::abs(scene.energy() / energy - 1));
  }
  EXPECT_LT((scene.bodies.momentum() - P).norm(), 1e-11 * P.norm());
  EXPECT_LT((scene.bodies.angular_momentum() - L).norm(), 1e-11 * L.norm());
  EXPECT_LT(off, 2e-4);
}

TEST(ArticulatedTree, ReportsTheForcesThatHold) {
  // What hangs at rest weighs on each joint by all that is below.
  JointScene scene;
  for (int k = 0; k < 3; ++k) scene.add_box({0.02, 0.02, 0.1}, {0, 0, -0.1 - 0.2 * k}, 1 + k);
  scene.add(make_hinge(scene.bodies, 0, -1, Vec3::Zero(), Vec3::UnitY()));
  scene.add(make_ball(scene.bodies, 0, 1, {0, 0, -0.2}));  // acts on the upper body
  scene.add(make_fixed(scene.bodies, 2, 1, {0.1, 0, -0.4}));
  scene.advance(0.1);
  EXPECT_NEAR(scene.joints[0].force.z(), 6 * g, 1e-9);
  EXPECT_NEAR(scene.joints[1].force.z(), -5 * g, 1e-9);
  EXPECT_NEAR(scene.joints[2].force.z(), 3 * g, 1e-9);
  EXPECT_NEAR(scene.joints[2].torque.y(), 3 * g * 0.1, 1e-9);
}

}  // namespace
