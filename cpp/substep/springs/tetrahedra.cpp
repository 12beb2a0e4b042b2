#include "substep/springs/tetrahedra.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/springs/elastic_energy.h"

namespace substep::springs {
namespace {

using V = Vector<double>;
using Matrix = Matrix3<V>;
constexpr std::int64_t kLanes = sizeof(V) / sizeof(double);
constexpr int kBlocks = 10;  // of the lower triangle of 4 x 4

// Elements first .. first + kLanes - 1, or fewer at the end.
struct Group {
  Group(const Tetrahedra& mesh, std::int64_t first_, std::int64_t end)
      : first(usize(first_)), count(static_cast<int>(std::min(kLanes, end - first_))) {
    for (int k = 0; k < 9; ++k) inverse(k / 3, k % 3) = load<V>(&mesh.inverse[k][first]);
    volume = load<V>(&mesh.volume[first]);
    lame = {load<V>(&mesh.mu[first]), load<V>(&mesh.lambda[first])};
  }

  // sum u_a g_a^T: F for positions, dF/dt for velocities.
  Matrix gradient_of(const Tetrahedra& mesh, Positions u) const {
    alignas(kVectorBytes) double edges[9][kLanes];
    const std::int32_t* const vertices = &mesh.vertices[4 * first];
    for (int lane = 0; lane < kLanes; ++lane) {
      const std::int32_t* const v = vertices + 4 * std::min(lane, count - 1);
      const double* const x0 = u[usize(v[0])].data();
      for (int a = 0; a < 3; ++a) {
        const double* const x = u[usize(v[a + 1])].data();
        for (int d = 0; d < 3; ++d) edges[3 * d + a][lane] = x[d] - x0[d];
      }
    }
    Matrix D;
    for (int k = 0; k < 9; ++k) D(k / 3, k % 3) = load<V>(edges[k]);
    return D * inverse;
  }

  std::size_t first;
  int count;
  Matrix inverse;
  V volume;
  Lame<V> lame;
};

// Rows of lanes, written as one row of `size` numbers per element.
template <int size>
void write_rows(const std::array<V, size>& values, int count, double* out) {
  for (int lane = 0; lane < count; ++lane) {
    for (std::size_t k = 0; k < size; ++k) out[k] = values[k][lane];
    out += size;
  }
}

// V P g_a for a = 1..3 are the columns of V P D_m^-T; the four sum to zero.
void write_gradient(const Group& group, const Matrix& P, Vec3* out) {
  const Matrix G = P * transpose(group.inverse);
  std::array<V, 12> rows;
  for (int d = 0; d < 3; ++d) {
    V sum{};
    for (int a = 0; a < 3; ++a) {
      const V g = group.volume * G(d, a);
      rows[usize(3 * (a + 1) + d)] = g;
      sum += g;
    }
    rows[usize(d)] = -sum;
  }
  write_rows<12>(rows, group.count, out->data());
}

constexpr std::size_t block_index(int a, int b) { return usize(a * (a + 1) / 2 + b); }

// The ten blocks K_ab, a >= b, from block(a, b) for a >= b >= 1: rows and columns sum to zero.
template <class Block>
void write_blocks(const Group& group, Block&& block, Mat3* out) {
  std::array<V, 9 * kBlocks> rows;  // each block by columns
  const auto entry = [&](int a, int b, int i, int j) -> V& {
    return a >= b ? rows[9 * block_index(a, b) + usize(3 * j + i)]
                  : rows[9 * block_index(b, a) + usize(3 * i + j)];
  };
  for (int a = 1; a < 4; ++a) {
    for (int b = 1; b <= a; ++b) {
      const Matrix K = block(a - 1, b - 1);
      for (int k = 0; k < 9; ++k) entry(a, b, k / 3, k % 3) = K(k / 3, k % 3);
    }
  }
  for (int a = 3; a >= 0; --a) {
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        entry(a, 0, i, j) = -(entry(a, 1, i, j) + entry(a, 2, i, j) + entry(a, 3, i, j));
      }
    }
  }
  write_rows<9 * kBlocks>(rows, group.count, out->data());
}

// What both terms share: elements by groups of lanes.
class TetrahedraTerm : public Term {
 public:
  explicit TetrahedraTerm(std::shared_ptr<const Tetrahedra> mesh) : mesh_(std::move(mesh)) {}
  int arity() const override { return 4; }
  std::span<const std::int32_t> vertices() const override { return mesh_->vertices; }

 protected:
  template <class Density>
  double sum(std::int64_t begin, std::int64_t end, Density&& density) const {
    double total = 0;
    for (std::int64_t first = begin; first < end; first += kLanes) {
      const Group group(*mesh_, first, end);
      const V energy = group.volume * density(group);
      for (int lane = 0; lane < group.count; ++lane) total += energy[lane];
    }
    return total;
  }

  std::shared_ptr<const Tetrahedra> mesh_;
};

template <class Model>
class ElasticTerm final : public TetrahedraTerm {
 public:
  using TetrahedraTerm::TetrahedraTerm;

  double energy(Positions x, std::int64_t begin, std::int64_t end) const override {
    return sum(begin, end, [&](const Group& group) {
      return Model::energy(group.gradient_of(*mesh_, x), group.lame);
    });
  }

  void derivatives(Positions x, std::int64_t begin, std::int64_t end, double kept, Vec3* gradient,
                   Mat3* hessian) const override {
    for (std::int64_t first = begin; first < end; first += kLanes) {
      const Group group(*mesh_, first, end);
      const Matrix F = group.gradient_of(*mesh_, x);
      write_gradient(group, Model::stress(F, group.lame), gradient + 4 * (first - begin));
      if (hessian) write_hessian(group, F, kept, hessian + kBlocks * (first - begin));
    }
  }

 private:
  static void write_hessian(const Group& group, const Matrix& F, double kept, Mat3* out) {
    const Svd3<V> svd = svd3(F);
    const PrincipalCurvature<V> H = filter(Model::curvature(svd.sigma, group.lame), kept);
    const Matrix p = group.inverse * svd.V;  // rows: V^T g_a
    const Matrix UT = transpose(svd.U);
    write_blocks(
        group,
        [&](int a, int b) {
          const Vector3<V> pa{{p(a, 0), p(a, 1), p(a, 2)}}, pb{{p(b, 0), p(b, 1), p(b, 2)}};
          return svd.U * principal_block(H, group.volume * pa, pb) * UT;
        },
        out);
  }
};

// With R = sym(F^T G), G = sum v_a g_a^T: dD/dG = F S, S = tau (2 mu R + lambda tr R). For a
// velocity w of corner b, R = sym(F^T w g_b^T); with q_a = F g_a this gives
//   K_ab = V tau (mu ((g_a . g_b) F F^T + q_b q_a^T) + lambda q_a q_b^T).
class ViscousTerm final : public TetrahedraTerm {
 public:
  ViscousTerm(std::shared_ptr<const Tetrahedra> mesh, double relaxation_time)
      : TetrahedraTerm(std::move(mesh)), tau_(relaxation_time) {}

  bool dissipative() const override { return true; }
  void lag(Positions x) override { lagged_.assign(x.begin(), x.end()); }

  double energy(Positions v, std::int64_t begin, std::int64_t end) const override {
    return sum(begin, end, [&](const Group& group) {
      const Matrix R = strain_rate(group.gradient_of(*mesh_, lagged_), group, v);
      const V trace = R(0, 0) + R(1, 1) + R(2, 2);
      return tau_ * (group.lame.mu * inner(R, R) + 0.5 * group.lame.lambda * trace * trace);
    });
  }

  void derivatives(Positions v, std::int64_t begin, std::int64_t end, double /*kept*/,
                   Vec3* gradient, Mat3* hessian) const override {
    for (std::int64_t first = begin; first < end; first += kLanes) {
      const Group group(*mesh_, first, end);
      const Matrix F = group.gradient_of(*mesh_, lagged_);
      const Matrix R = strain_rate(F, group, v);
      const V trace = R(0, 0) + R(1, 1) + R(2, 2);
      const Matrix S = combine<V>(2.0 * tau_ * group.lame.mu, R, tau_ * group.lame.lambda * trace,
                                  Matrix::identity());
      write_gradient(group, F * S, gradient + 4 * (first - begin));
      if (hessian) write_hessian(group, F, hessian + kBlocks * (first - begin));
    }
  }

 private:
  Matrix strain_rate(const Matrix& F, const Group& group, Positions v) const {
    const Matrix A = transpose(F) * group.gradient_of(*mesh_, v);
    return combine<V>(V{} + 0.5, A, V{} + 0.5, transpose(A));
  }

  void write_hessian(const Group& group, const Matrix& F, Mat3* out) const {
    const Matrix B = F * transpose(F), Q = F * transpose(group.inverse);  // columns: q_a
    const V mu = tau_ * group.volume * group.lame.mu;
    const V lambda = tau_ * group.volume * group.lame.lambda;
    write_blocks(
        group,
        [&](int a, int b) {
          const V gg = group.inverse(a, 0) * group.inverse(b, 0) +
                       group.inverse(a, 1) * group.inverse(b, 1) +
                       group.inverse(a, 2) * group.inverse(b, 2);
          Matrix K;
          for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) {
              K(i, j) = mu * (gg * B(i, j) + Q(i, b) * Q(j, a)) + lambda * Q(i, a) * Q(j, b);
            }
          }
          return K;
        },
        out);
  }

  double tau_;
  std::vector<Vec3> lagged_;
};

}  // namespace

Tetrahedra::Tetrahedra(Positions rest, std::vector<std::int32_t> corners,
                       std::span<const double> young_modulus, std::span<const double> poisson_ratio)
    : vertices(std::move(corners)) {
  const std::size_t n = usize(count());
  const std::size_t padded = n + usize(kLanes);
  for (std::vector<double>& component : inverse) component.resize(padded);
  volume.resize(padded);
  mu.resize(padded);
  lambda.resize(padded);
  for (std::size_t e = 0; e < n; ++e) {
    const auto x = [&](std::size_t a) -> const Vec3& { return rest[usize(vertices[4 * e + a])]; };
    Mat3 D;
    D << x(1) - x(0), x(2) - x(0), x(3) - x(0);
    const Mat3 D_inverse = D.inverse();
    for (int k = 0; k < 9; ++k) inverse[k][e] = D_inverse(k / 3, k % 3);
    volume[e] = D.determinant() / 6;
    const double E = young_modulus[e], nu = poisson_ratio[e];
    mu[e] = E / (2 * (1 + nu));
    lambda[e] = E * nu / ((1 + nu) * (1 - 2 * nu));
  }
}

std::vector<std::string> elastic_models() {
  std::vector<std::string> names;
  any_model([&](const char* name, auto) {
    names.emplace_back(name);
    return false;
  });
  return names;
}

std::shared_ptr<Term> make_elastic_term(const std::string& model,
                                        std::shared_ptr<const Tetrahedra> tetrahedra) {
  std::shared_ptr<Term> term;
  any_model([&]<class Model>(const char* name, Model) {
    if (model == name) term = std::make_shared<ElasticTerm<Model>>(tetrahedra);
    return term != nullptr;
  });
  if (!term) throw InputError("model: unknown name " + model);
  return term;
}

std::shared_ptr<Term> make_viscous_term(std::shared_ptr<const Tetrahedra> tetrahedra,
                                        double relaxation_time) {
  return std::make_shared<ViscousTerm>(std::move(tetrahedra), relaxation_time);
}

}  // namespace substep::springs
