// B-splines and the affine transfer: on collocated and staggered grids, all orders, 2D and 3D.
#include "substep/transfer/apic.h"

#include <gtest/gtest.h>

#include <map>
#include <random>
#include <vector>

namespace substep::transfer {
namespace {

template <int kOrder>
void check_spline(double x) {
  const auto s = spline<kOrder>(x);
  double sum = 0, first = 0, second = 0, slope = 0, slope_of_x = 0;
  for (int k = 0; k <= kOrder; ++k) {
    const double r = s.first + k - x;
    EXPECT_GE(s.w[k], 0);
    EXPECT_LE(std::abs(r), 0.5 * (kOrder + 1) + 1e-15);
    sum += s.w[k], first += s.w[k] * r, second += s.w[k] * r * r;
    slope += s.g[k], slope_of_x += s.g[k] * r;
    // The affine weight is D^-1 w r; for order 1 the limit of it.
    const double D = second_moment(s);
    if (D > 1e-3) {
      EXPECT_NEAR(affine_weight(s, k), s.w[k] * r / D, 1e-12);
    }
    // The gradient is that of the weight (central differences; inside of a cell).
    const double h = 1e-5;
    const auto before = spline<kOrder>(x - h), after = spline<kOrder>(x + h);
    if (before.first == s.first && after.first == s.first) {
      EXPECT_NEAR(s.g[k], (after.w[k] - before.w[k]) / (2 * h), 1e-9);
    }
  }
  EXPECT_NEAR(s.first + s.distance, x, 1e-15 * (1 + std::abs(x)));
  EXPECT_NEAR(sum, 1, 1e-15);
  EXPECT_NEAR(first, 0, 1e-15);
  EXPECT_NEAR(second, second_moment(s), 1e-15);
  EXPECT_NEAR(slope, 0, 1e-15);
  EXPECT_NEAR(slope_of_x, 1, 1e-15);
}

TEST(Splines, SumToOneAndReproduceLinearFields) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-5, 5);
  std::vector<double> points{-2, -1.5, 0, 0.5, 1, 1 - 1e-16, 3.5};
  for (int k = 0; k < 500; ++k) points.push_back(uniform(random));
  for (const double x : points) {
    check_spline<1>(x), check_spline<2>(x), check_spline<3>(x);
  }
}

TEST(Splines, ValuesAtNodesAndBetween) {
  EXPECT_DOUBLE_EQ(spline<2>(3.0).w[1], 0.75);
  EXPECT_DOUBLE_EQ(spline<2>(3.0).w[0], 0.125);
  EXPECT_DOUBLE_EQ(spline<3>(3.0).w[1], 2.0 / 3);
  EXPECT_DOUBLE_EQ(spline<3>(3.5).w[0], 1.0 / 48);
  EXPECT_DOUBLE_EQ(spline<3>(3.5).w[1], 23.0 / 48);
  EXPECT_DOUBLE_EQ(spline<1>(3.25).w[1], 0.25);
}

template <class G, int order, int dimension>
struct Case {
  using Grid = G;
  static constexpr int kOrder = order, kDimension = dimension;
};

template <class C>
class Apic : public testing::Test {
 protected:
  static constexpr int D = C::kDimension;
  using Vec = std::array<double, D>;
  using Nodes = std::map<Index<D>, NodeSum<double>>;
  struct Particle {
    Vec x;
    double mass;
    AffineMotion<double, D> motion;
  };
  static constexpr double kCell = 0.3;  // [m]

  void SetUp() override {
    std::mt19937 random(7);
    std::uniform_real_distribution<double> uniform(-1, 1);
    particles.resize(200);
    for (Particle& p : particles) {
      for (double& x : p.x) x = 3 * uniform(random);
      p.mass = 1.5 + uniform(random);
      for (double& v : p.motion.v) v = uniform(random);
      for (auto& row : p.motion.C) {
        for (double& c : row) c = uniform(random);
      }
    }
    particles[0].x = {};  // at a node, where D of order 1 is singular
  }
  std::array<Nodes, D> to_grid() const {
    std::array<Nodes, D> nodes;
    for (const Particle& p : particles) {
      particle_to_grid<typename C::Grid, C::kOrder>(
          p.x, p.mass, p.motion, kCell,
          [&](int c, const Index<D>& i) -> NodeSum<double>& { return nodes[unsigned(c)][i]; });
    }
    return nodes;
  }
  AffineMotion<double, D> from_grid(const std::array<Nodes, D>& nodes, const Vec& x) const {
    return grid_to_particle<typename C::Grid, C::kOrder>(x, kCell, [&](int c, const Index<D>& i) {
      const NodeSum<double>& n = nodes[unsigned(c)].at(i);
      return n.momentum / n.mass;
    });
  }
  static double position(int c, unsigned axis, const Index<D>& i) {
    return kCell * (i[axis] + C::Grid::offset(c, int(axis)));
  }

  // Mass, momentum and angular momentum (of the planes (a, b), a < b) of the grid.
  struct Sums {
    std::vector<double> values;
  };
  static Sums sums(const std::array<Nodes, D>& nodes) {
    Sums s;
    std::array<std::array<double, D>, D> moment{};  // sum x_a m v_b
    for (unsigned c = 0; c < D; ++c) {
      double mass = 0, momentum = 0;
      for (const auto& [i, n] : nodes[c]) {
        mass += n.mass, momentum += n.momentum;
        for (unsigned a = 0; a < D; ++a) moment[a][c] += position(int(c), a, i) * n.momentum;
      }
      s.values.push_back(mass), s.values.push_back(momentum);
    }
    return antisymmetric(s, moment);
  }
  // The same of particles, with the affine part m C D.
  static Sums sums(const std::vector<Particle>& particles) {
    Sums s;
    std::array<std::array<double, D>, D> moment{};
    for (unsigned c = 0; c < D; ++c) {
      double mass = 0, momentum = 0;
      for (const Particle& p : particles) {
        mass += p.mass, momentum += p.mass * p.motion.v[c];
        const auto stencil = weights<typename C::Grid, C::kOrder>(p.x, int(c));
        for (unsigned a = 0; a < D; ++a) {
          const double D_a = kCell * kCell * second_moment(stencil.axis[a]);
          moment[a][c] += p.mass * (kCell * p.x[a] * p.motion.v[c] + p.motion.C[c][a] * D_a);
        }
      }
      s.values.push_back(mass), s.values.push_back(momentum);
    }
    return antisymmetric(s, moment);
  }
  static Sums antisymmetric(Sums s, const std::array<std::array<double, D>, D>& moment) {
    for (unsigned a = 0; a < D; ++a) {
      for (unsigned b = a + 1; b < D; ++b) s.values.push_back(moment[a][b] - moment[b][a]);
    }
    return s;
  }
  static void expect_equal(const Sums& a, const Sums& b) {
    ASSERT_EQ(a.values.size(), b.values.size());
    for (std::size_t k = 0; k < a.values.size(); ++k) {
      EXPECT_NEAR(a.values[k], b.values[k], 1e-12 * 200) << k;  // 200 particles of about 1 kg
    }
  }

  std::vector<Particle> particles;
};

using Cases =
    testing::Types<Case<Staggered, 1, 2>, Case<Staggered, 2, 2>, Case<Staggered, 3, 2>,
                   Case<Staggered, 1, 3>, Case<Staggered, 2, 3>, Case<Staggered, 3, 3>,
                   Case<Collocated, 1, 2>, Case<Collocated, 2, 2>, Case<Collocated, 3, 2>,
                   Case<Collocated, 1, 3>, Case<Collocated, 2, 3>, Case<Collocated, 3, 3>>;
TYPED_TEST_SUITE(Apic, Cases);

TYPED_TEST(Apic, IsExactOnLinearFields) {
  constexpr int dimension = TypeParam::kDimension;
  AffineMotion<double, dimension> field;  // at x = 0
  for (unsigned a = 0; a < dimension; ++a) {
    field.v[a] = 0.5 - a;
    for (unsigned b = 0; b < dimension; ++b) field.C[a][b] = 0.3 + 1.7 * a - 0.9 * b * b;
  }
  const auto velocity = [&](unsigned a, const std::array<double, dimension>& x) {  // x in m
    double v = field.v[a];
    for (unsigned b = 0; b < dimension; ++b) v += field.C[a][b] * x[b];
    return v;
  };
  for (auto& p : this->particles) {
    std::array<double, dimension> x;
    for (unsigned a = 0; a < dimension; ++a) x[a] = this->kCell * p.x[a];
    for (unsigned a = 0; a < dimension; ++a) p.motion.v[a] = velocity(a, x);
    p.motion.C = field.C;
  }
  const auto nodes = this->to_grid();
  for (unsigned c = 0; c < dimension; ++c) {
    for (const auto& [i, n] : nodes[c]) {
      std::array<double, dimension> x;
      for (unsigned a = 0; a < dimension; ++a) x[a] = this->position(int(c), a, i);
      EXPECT_NEAR(n.momentum, n.mass * velocity(c, x), 1e-13 * 10);
    }
  }
  // Velocities at the nodes that are the linear field give it back to the particle.
  for (const auto& p : this->particles) {
    const auto motion = grid_to_particle<typename TypeParam::Grid, TypeParam::kOrder>(
        p.x, this->kCell, [&](int c, const Index<dimension>& i) {
          std::array<double, dimension> x;
          for (unsigned a = 0; a < dimension; ++a) x[a] = this->position(c, a, i);
          return velocity(unsigned(c), x);
        });
    for (unsigned a = 0; a < dimension; ++a) {
      EXPECT_NEAR(motion.v[a], p.motion.v[a], 1e-13);
      for (unsigned b = 0; b < dimension; ++b) EXPECT_NEAR(motion.C[a][b], field.C[a][b], 1e-12);
    }
  }
}

TYPED_TEST(Apic, ConservesMomentumAndAngularMomentumToTheGridAndBack) {
  const auto nodes = this->to_grid();
  this->expect_equal(this->sums(nodes), this->sums(this->particles));
  auto after = this->particles;
  for (auto& p : after) p.motion = this->from_grid(nodes, p.x);
  this->expect_equal(this->sums(after), this->sums(nodes));
}

// Without the affine part (PIC) the angular momentum is lost: the test above can fail.
TYPED_TEST(Apic, LosesAngularMomentumWithoutTheAffinePart) {
  const auto before = this->sums(this->particles);
  for (auto& p : this->particles) p.motion.C = {};
  const auto after = this->sums(this->to_grid());
  EXPECT_GT(std::abs(after.values.back() - before.values.back()), 1e-3);
}

}  // namespace
}  // namespace substep::transfer
