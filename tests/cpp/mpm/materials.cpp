// Every material of the list, from what all of them promise: the stress is the derivative of the
// energy, nothing depends on the frame, plane strain is three dimensions, a lane knows nothing of
// its neighbours, and what is not finite comes out. The list mpm/materials/materials.h enrols them.
#include <gtest/gtest.h>

#include <limits>
#include <string>

#include "samples.h"

namespace {

using namespace substep;
using namespace substep::mpm;

template <class>
struct TypesOf;
template <class... M>
struct TypesOf<std::variant<M...>> {
  using type = testing::Types<M...>;
};

// Within the yield surfaces of the usual constants: a little compressed, hardly sheared.
template <class Random>
Matrix3d elastic_deformation(Random& random, int D = 3) {
  Matrix3d F = Matrix3d::Identity() + 0.002 * random_matrix(random, D);
  F *= 0.99;
  if (D == 2) F(2, 2) = 1;
  return random_rotation(random, D) * F;
}

// Beyond them.
template <class Random>
Matrix3d large_deformation(Random& random, int D = 3) {
  Matrix3d F = 0.95 * Matrix3d::Identity() + 0.15 * random_matrix(random, D);
  if (D == 2) F(2, 2) = 1;
  return random_rotation(random, D) * F;
}

template <class M>
class EveryMaterial : public testing::Test {};
struct Names {
  template <class M>
  static std::string GetName(int) {
    return M::kName;
  }
};
TYPED_TEST_SUITE(EveryMaterial, TypesOf<AnyMaterial>::type, Names);

TYPED_TEST(EveryMaterial, keeps_the_promises_of_the_concept) {
  static_assert(Material<TypeParam>);
  Packet<TypeParam> rest;
  rest.stress(1e-3);
  EXPECT_EQ(rest.stress_of().norm(), 0);
  EXPECT_NEAR(rest.energy(), 0, 1e-11);
  EXPECT_GT(rest.modulus(), 0);
  for (int f = 0; f < rest.kFields; ++f)
    EXPECT_EQ(rest.fields[f][0], Packet<TypeParam>().fields[f][0]);
}

// d psi = tau : G for a small step along any G, since F <- (I + G) F gives dF F^-1 = G.
TYPED_TEST(EveryMaterial, stress_is_the_derivative_of_the_energy) {
  std::mt19937 random(1);
  for (int trial = 0; trial < 20; ++trial) {
    const Matrix3d F = elastic_deformation(random), G = random_matrix(random);
    Packet<TypeParam> here, ahead, behind;
    for (auto* packet : {&here, &ahead, &behind}) packet->deform(F);
    here.stress();
    const double h = 1e-5;
    ahead.advance(G, h);
    behind.advance(G, -h);
    const double derivative = (ahead.energy() - behind.energy()) / (2 * h);
    const double work = here.stress_of().cwiseProduct(G).sum();
    EXPECT_NEAR(derivative, work, 1e-6 * here.stress_of().norm() + 1e-4);
    EXPECT_NE(work, 0);
  }
}

// Q F in place of F gives Q tau Q^T, and the same numbers of its own.
TYPED_TEST(EveryMaterial, is_objective) {
  std::mt19937 random(2);
  for (int trial = 0; trial < 20; ++trial) {
    const Matrix3d F = trial % 2 ? large_deformation(random) : elastic_deformation(random);
    const Matrix3d Q = random_rotation(random), G = random_matrix(random);
    Packet<TypeParam> one, turned;
    one.deform(F);
    turned.deform(Q * F);
    one.stress(1e-3, G);
    turned.stress(1e-3, Q * G * Q.transpose());
    const Matrix3d expected = Q * one.stress_of() * Q.transpose();
    EXPECT_LT((turned.stress_of() - expected).norm(), 1e-11 * kLambda);
    EXPECT_NEAR(turned.energy(), one.energy(), 1e-11 * kLambda);
    for (int k = 0; k < static_cast<int>(TypeParam::kState.size()); ++k) {
      EXPECT_NEAR(turned.own(k), one.own(k), 1e-12);
    }
  }
}

// The return map gives a state on or below the yield surface, which it then leaves alone.
TYPED_TEST(EveryMaterial, an_admissible_state_stays) {
  std::mt19937 random(3);
  for (int trial = 0; trial < 20; ++trial) {
    Packet<TypeParam> packet;
    packet.deform(large_deformation(random));
    packet.stress(0);
    auto again = packet;
    again.stress(0);
    EXPECT_LT((again.stress_of() - packet.stress_of()).norm(), 1e-10 * kLambda);
  }
}

// 2D is plane strain: the same numbers as those of F with zz alone out of the plane.
template <class M, class T>
void check_plane_strain(double tolerance) {
  std::mt19937 random(4);
  for (int trial = 0; trial < 20; ++trial) {
    const Matrix3d F = trial % 2 ? large_deformation(random, 2) : elastic_deformation(random, 2);
    const Matrix3d G = random_matrix(random, 2);
    Packet<M, T, 2> plane;
    Packet<M, T, 3> space;
    plane.deform(F);
    space.deform(F);
    plane.advance(G, 1e-2);
    space.advance(G, 1e-2);
    plane.stress(1e-2, G);
    space.stress(1e-2, G);
    EXPECT_LT((plane.stress_of() - space.stress_of()).norm(), tolerance * 1e5);
    EXPECT_NEAR(plane.energy(), space.energy(), tolerance * 1e5);
    EXPECT_NEAR(plane.modulus(), space.modulus(), tolerance * space.modulus());
    if constexpr (M::kHasF) {
      EXPECT_LT((plane.F() - space.F()).norm(), tolerance);
    }
    for (int k = 0; k < static_cast<int>(M::kState.size()); ++k) {
      EXPECT_NEAR(plane.own(k), space.own(k), tolerance);
    }
  }
}
TYPED_TEST(EveryMaterial, in_two_dimensions_is_plane_strain) {
  check_plane_strain<TypeParam, double>(1e-13);
  check_plane_strain<TypeParam, float>(1e-5);
}

// Bits of a lane depend neither on its neighbours nor on how many packets are computed together.
TYPED_TEST(EveryMaterial, lanes_are_independent) {
  using V = Vector<float>;
  constexpr int kFields = TypeParam::template kFields<3>, kPackets = 2;
  const TypeParam material = usual<TypeParam>();
  std::mt19937 random(5);
  Packet<TypeParam, float> mixed[kPackets];
  for (auto& packet : mixed) {
    for (int lane = 0; lane < packet.kLanes; ++lane) {
      packet.deform(lane, lane % 3 == 0   ? elastic_deformation(random)
                          : lane % 3 == 1 ? large_deformation(random)
                                          : Matrix3d(-large_deformation(random)));
    }
  }
  const Packet<TypeParam, float> before[kPackets] = {mixed[0], mixed[1]};
  const Tensor<V, 3> G[kPackets] = {};
  V* const fields[kPackets] = {mixed[0].fields, mixed[1].fields};
  SymmetricTensor<V, 3> tau[kPackets];
  material.template stress<V, 3, kPackets>(fields, G, 1e-3f, tau);
  for (int p = 0; p < kPackets; ++p) {
    for (int lane = 0; lane < kWidth<float>; ++lane) {
      Packet<TypeParam, float> alone;
      for (int f = 0; f < kFields; ++f) alone.fields[f] = splat<V>(before[p].fields[f][lane]);
      alone.stress(1e-3);
      for (int k = 0; k < 6; ++k) {
        const float a = alone.tau.m[k][0], b = tau[p].m[k][lane];
        EXPECT_TRUE(a == b || (std::isnan(a) && std::isnan(b))) << p << " " << lane << " " << k;
      }
      for (int f = 0; f < kFields; ++f) {
        const float a = alone.fields[f][0], b = mixed[p].fields[f][lane];
        EXPECT_TRUE(a == b || (std::isnan(a) && std::isnan(b))) << p << " " << lane << " " << f;
      }
    }
  }
}

// F or J that is not finite shows in the stress of its lane, at once, and nowhere else; so does det
// F <= 0 where the model has no answer.
template <class M, class T>
void check_bad_values() {
  constexpr int kDeformation = M::kHasF ? 9 : 1;
  const auto finite = [](const Matrix3d& A) { return A.allFinite(); };
  for (const T bad : {std::numeric_limits<T>::quiet_NaN(), std::numeric_limits<T>::infinity(),
                      -std::numeric_limits<T>::infinity()}) {
    for (int f = 0; f < kDeformation; ++f) {
      Packet<M, T> packet;
      packet.fields[f][1] = bad;
      packet.stress(1e-3);
      EXPECT_FALSE(finite(packet.stress_of(1))) << "field " << f << " is " << bad;
      EXPECT_TRUE(finite(packet.stress_of(0)));
    }
  }
  std::mt19937 random(6);
  for (int trial = 0; trial < 20; ++trial) {
    Packet<M, T> packet;
    packet.deform(-large_deformation(random));
    packet.stress(1e-3);
    EXPECT_EQ(finite(packet.stress_of()), M::kInverts);
  }
  // F without volume, exactly: it may have an answer where inverted F has one.
  Packet<M, T> flat;
  flat.deform(diagonal(1, 0.7, 0));
  flat.stress(1e-3);
  EXPECT_LE(finite(flat.stress_of()), M::kInverts);
}
TYPED_TEST(EveryMaterial, bad_values_come_out) {
  check_bad_values<TypeParam, double>();
  check_bad_values<TypeParam, float>();
}

// Single precision gives what double precision gives.
TYPED_TEST(EveryMaterial, floats_are_near_doubles) {
  std::mt19937 random(7);
  for (int trial = 0; trial < 50; ++trial) {
    const Matrix3d F = trial % 2 ? large_deformation(random) : elastic_deformation(random);
    Packet<TypeParam, double> a;
    Packet<TypeParam, float> b;
    a.deform(F);
    b.deform(F);
    a.stress(1e-3);
    b.stress(1e-3);
    // Of the largest modulus there is: K or h (lambda + 2 mu).
    EXPECT_LT((a.stress_of() - b.stress_of()).norm(), 5e-6 * a.modulus());
    if constexpr (TypeParam::kHasF) {
      EXPECT_LT((a.F() - b.F()).norm(), 5e-6);
    }
  }
}

// The wave modulus is not below the stiffness of any stretch along an axis: (tau' - tau) : n n / h.
TYPED_TEST(EveryMaterial, wave_modulus_bounds_the_stiffness) {
  std::mt19937 random(8);
  double sharpest = 0;
  for (int trial = 0; trial < 60; ++trial) {
    Packet<TypeParam> here;
    here.deform(elastic_deformation(random));
    auto ahead = here;
    Eigen::Vector3d n = random_matrix(random).col(0).normalized();
    ahead.advance(n * n.transpose(), 1e-6);
    here.stress();
    ahead.stress();
    const double stiffness = n.dot((ahead.stress_of() - here.stress_of()) * n) / 1e-6;
    EXPECT_LT(stiffness, 1.05 * here.modulus());
    sharpest = std::max(sharpest, stiffness / here.modulus());
  }
  EXPECT_GT(sharpest, 0.9);
}

}  // namespace
