#include "substep/springs/tetrahedra.h"

#include <gtest/gtest.h>

#include <Eigen/LU>

#include "substep/core/errors.h"
#include "substep/core/random.h"
#include "substep/core/usize.h"

namespace {

using substep::usize;

using namespace substep;
using namespace substep::springs;

Vec3 random_vector(std::uint64_t index) {
  const auto a = uniform2(5, index), b = uniform2(5, index, 1);
  return {2 * a[0] - 1, 2 * a[1] - 1, 2 * b[0] - 1};
}

// Tetrahedra that share a fan of random vertices, so that groups of lanes are cut off at the end.
struct Fan {
  explicit Fan(int count) {
    for (int i = 0; i < count + 3; ++i)
      rest.push_back(random_vector(static_cast<std::uint64_t>(i)));
    for (int e = 0; e < count; ++e) {
      Mat3 D;
      D << rest[e + 1] - rest[e], rest[e + 2] - rest[e], rest[e + 3] - rest[e];
      const bool upright = D.determinant() > 0;
      for (const int v : {e, e + 1, upright ? e + 2 : e + 3, upright ? e + 3 : e + 2}) {
        vertices.push_back(v);
      }
      young_modulus.push_back(1.0 + e);
      poisson_ratio.push_back(-0.2 + 0.03 * e);
    }
    mesh = std::make_shared<Tetrahedra>(rest, vertices, young_modulus, poisson_ratio);
    for (std::size_t i = 0; i < rest.size(); ++i) {
      now.push_back(rest[i] + 0.3 * random_vector(100 + i));
    }
  }
  std::vector<std::shared_ptr<Term>> terms() const {
    std::vector<std::shared_ptr<Term>> all;
    for (const std::string& model : elastic_models()) all.push_back(make_elastic_term(model, mesh));
    all.push_back(make_viscous_term(mesh, 0.3));
    all.back()->lag(now);
    return all;
  }

  std::vector<Vec3> rest, now;
  std::vector<std::int32_t> vertices;
  std::vector<double> young_modulus, poisson_ratio;
  std::shared_ptr<const Tetrahedra> mesh;
};

struct Derivatives {
  Derivatives(const Term& term, Positions x, std::int64_t begin, std::int64_t end, double kept)
      : gradient(usize(4 * (end - begin))), hessian(usize(10 * (end - begin))) {
    term.derivatives(x, begin, end, kept, gradient.data(), hessian.data());
  }
  std::vector<Vec3> gradient;
  std::vector<Mat3> hessian;
};

TEST(Tetrahedra, DerivativesAreThoseOfFiniteDifferences) {
  constexpr double h = 1e-6;
  const Fan fan(13);
  for (const auto& term : fan.terms()) {
    const Derivatives exact(*term, fan.now, 0, 13, 1.0);
    for (int e = 0; e < 13; ++e) {
      double largest = 0;
      for (int k = 0; k < 10; ++k) {
        largest = std::max(largest, exact.hessian[10 * e + k].cwiseAbs().maxCoeff());
      }
      for (int b = 0; b < 4; ++b) {
        for (int d = 0; d < 3; ++d) {
          std::vector<Vec3> plus = fan.now, minus = fan.now;
          plus[fan.vertices[4 * e + b]][d] += h;
          minus[fan.vertices[4 * e + b]][d] -= h;
          const double slope =
              (term->energy(plus, e, e + 1) - term->energy(minus, e, e + 1)) / (2 * h);
          EXPECT_NEAR(exact.gradient[4 * e + b][d], slope, 1e-7 * largest);
          const Derivatives up(*term, plus, e, e + 1, 1.0), down(*term, minus, e, e + 1, 1.0);
          for (int a = b; a < 4; ++a) {
            const Vec3 column = (up.gradient[a] - down.gradient[a]) / (2 * h);
            const Mat3& block = exact.hessian[10 * e + a * (a + 1) / 2 + b];
            EXPECT_LE((block.col(d) - column).cwiseAbs().maxCoeff(), 1e-6 * largest);
          }
        }
      }
    }
  }
}

TEST(Tetrahedra, FilteredHessiansArePositiveSemidefinite) {
  const Fan fan(13);
  for (const auto& term : fan.terms()) {
    const Derivatives filtered(*term, fan.now, 0, 13, 0.0), exact(*term, fan.now, 0, 13, 1.0);
    for (int e = 0; e < 13; ++e) {
      for (std::uint64_t sample = 0; sample < 200; ++sample) {
        Vec3 u[4];
        for (std::uint64_t a = 0; a < 4; ++a) u[a] = random_vector(1000 + 4 * sample + a);
        double sum = 0, exact_sum = 0, size = 0;
        for (int a = 0; a < 4; ++a) {
          for (int b = 0; b < 4; ++b) {
            const int k = 10 * e + (a >= b ? a * (a + 1) / 2 + b : b * (b + 1) / 2 + a);
            const Mat3 block = a >= b ? filtered.hessian[k] : Mat3(filtered.hessian[k].transpose());
            const Mat3 other = a >= b ? exact.hessian[k] : Mat3(exact.hessian[k].transpose());
            sum += u[a].dot(block * u[b]);
            exact_sum += u[a].dot(other * u[b]);
            size += block.cwiseAbs().maxCoeff();
          }
        }
        EXPECT_GE(sum, -1e-13 * size);
        EXPECT_GE(sum, exact_sum - 1e-13 * size);  // what was left out is negative
      }
    }
  }
}

TEST(Tetrahedra, ElementsDoNotDependOnWhereTheirGroupBegins) {
  const Fan fan(13);
  for (const auto& term : fan.terms()) {
    const Derivatives all(*term, fan.now, 0, 13, 0.0);
    for (int e = 0; e < 13; ++e) {
      const Derivatives one(*term, fan.now, e, e + 1, 0.0);
      for (int a = 0; a < 4; ++a) EXPECT_EQ(all.gradient[4 * e + a], one.gradient[a]);
      for (int k = 0; k < 10; ++k) EXPECT_EQ(all.hessian[10 * e + k], one.hessian[k]);
    }
  }
}

TEST(Tetrahedra, AnUnknownModelIsRefused) {
  EXPECT_THROW(make_elastic_term("rubber", Fan(1).mesh), InputError);
}

}  // namespace
