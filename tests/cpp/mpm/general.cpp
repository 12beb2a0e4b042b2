// The general transfers of the material point method: against a reference that knows no blocks, and
// what each scheme conserves.
#include "substep/mpm/general/general.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <map>
#include <string>
#include <vector>

#include "cloud.h"
#include "substep/transfer/weights.h"

namespace substep::mpm {
namespace {

constexpr double kCell = 0.1, kDt = 2e-3;
constexpr Transfer kTransfers[] = {Transfer::kPic, Transfer::kFlip, Transfer::kApic,
                                   Transfer::kAflip};
constexpr Form kForms[] = {Form::kMls, Form::kTextbook};

std::string name(const Scheme& s) {
  return "order " + std::to_string(s.order) + ", transfer " + std::to_string(int(s.transfer)) +
         ", form " + std::to_string(int(s.form)) + (s.musl ? ", MUSL" : "");
}

// One step as the formulas of general.h stand, particle by particle on a map of nodes.
template <int kOrder, int D>
void reference_step(const Scheme& scheme, const NeoHookean& material, double dt,
                    const std::array<double, D>& gravity, Cloud<D>& cloud) {
  using Vec = Eigen::Matrix<double, D, 1>;
  using Mat = Eigen::Matrix<double, D, D>;
  struct Node {
    double mass = 0;
    Vec plain = Vec::Zero(), force = Vec::Zero(), before = Vec::Zero(), v = Vec::Zero();
    double share = 0;                                // MUSL: sum w
    Vec again = Vec::Zero(), deforms = Vec::Zero();  // m v', v''
  };
  const auto vec = [](const auto& a) { return Vec(Eigen::Map<const Vec>(a.data())); };
  const auto mat = [](const auto& a) {
    Mat M;
    for (unsigned i = 0; i < D; ++i) M.row(i) = Eigen::Map<const Vec>(a[i].data()).transpose();
    return M;
  };
  std::map<transfer::Index<D>, Node> nodes;
  const auto for_nodes = [&](const CloudParticle<D>& p, auto&& visit) {
    const auto s = transfer::weights<transfer::Collocated, kOrder>(p.X, 0);
    for (int n = 0; n < s.kNodes; ++n) {
      const auto k = s.offsets(n);
      visit(nodes[s.node(k)], s.weight(k), Vec(kCell * vec(s.arm(k))),
            Vec(vec(s.affine(k)) / kCell), Vec(vec(s.gradient(k)) / kCell));
    }
  };
  for (const auto& p : cloud) {
    const Mat F = mat(p.F), I = Mat::Identity();
    const double J = F.determinant(), m = material.density * p.volume;
    const Mat tau = material.mu * (F * F.transpose() - I) + material.lambda / 2 * (J * J - 1) * I;
    const Mat C = is_affine(scheme.transfer) ? mat(p.C) : Mat::Zero();
    for_nodes(p, [&](Node& n, double w, const Vec& r, const Vec& affine, const Vec& gradient) {
      n.mass += m * w;
      n.plain += m * w * (vec(p.v) + C * r);
      n.force -= p.volume * tau * (scheme.form == Form::kMls ? affine : gradient);
    });
  }
  for (auto& [i, n] : nodes) {
    n.before = n.plain / n.mass;
    n.v = n.before + dt * (n.force / n.mass + vec(gravity));
  }
  const double alpha = std::exp(-scheme.flip_rate * dt);
  std::vector<Vec> moved;
  std::vector<Mat> spins;
  for (auto& p : cloud) {
    const double m = material.density * p.volume;
    const Mat C = is_affine(scheme.transfer) ? mat(p.C) : Mat::Zero();
    Vec v = Vec::Zero(), before = Vec::Zero();
    Mat seen = Mat::Zero();
    for_nodes(p, [&](Node& n, double w, const Vec&, const Vec& affine, const Vec&) {
      v += w * n.v, before += w * n.before, seen += n.before * affine.transpose();
    });
    moved.push_back(v);
    const Mat unseen = mat(p.C) - seen;
    spins.push_back(alpha / 2 * (unseen - unseen.transpose()));
    if (keeps_change(scheme.transfer)) v += alpha * (vec(p.v) - before);
    for_nodes(p, [&](Node& n, double w, const Vec& r, const Vec&, const Vec&) {
      n.again += m * w * (v + C * r), n.share += w;
    });
    for (unsigned i = 0; i < D; ++i) p.v[i] = v[i];
  }
  for (auto& [i, n] : nodes) {
    const double kept = is_affine(scheme.transfer) ? std::min(1.0, n.share) : 0;
    const double share = scheme.musl ? kept : 1;
    n.deforms = share * n.v + (1 - share) * n.again / n.mass;
  }
  for (std::size_t k = 0; k < cloud.size(); ++k) {
    auto& p = cloud[k];
    Mat C = Mat::Zero(), G = Mat::Zero();
    for_nodes(p, [&](Node& n, double, const Vec&, const Vec& affine, const Vec& gradient) {
      C += n.deforms * affine.transpose(), G += n.deforms * gradient.transpose();
    });
    if (scheme.form == Form::kMls) G = C;
    const Mat F = (Mat::Identity() + dt * G) * mat(p.F);
    if (!is_affine(scheme.transfer)) C = G;
    if (scheme.transfer == Transfer::kAflip && !scheme.musl) C += spins[k];
    for (unsigned i = 0; i < D; ++i) {
      p.X[i] += dt / kCell * moved[k][i];
      for (unsigned j = 0; j < D; ++j) p.C[i][j] = C(i, j), p.F[i][j] = F(i, j);
    }
  }
}

// The largest difference in x, v, C or F, relative to the largest such number of b.
template <int D>
double largest_difference(const Cloud<D>& a, const Cloud<D>& b) {
  std::array<double, 4> largest{}, difference{};
  const auto differ = [&](unsigned what, double x, double y) {
    largest[what] = std::max(largest[what], std::abs(y));
    if (!(std::abs(x - y) <= difference[what])) difference[what] = std::abs(x - y);  // NaN too
  };
  for (std::size_t k = 0; k < a.size(); ++k) {
    for (std::size_t i = 0; i < D; ++i) {
      differ(0, a[k].X[i], b[k].X[i]), differ(1, a[k].v[i], b[k].v[i]);
      for (std::size_t j = 0; j < D; ++j) {
        differ(2, a[k].C[i][j], b[k].C[i][j]), differ(3, a[k].F[i][j], b[k].F[i][j]);
      }
    }
  }
  double result = 0;
  for (unsigned what = 0; what < 4; ++what) {
    const double relative = difference[what] / largest[what];
    if (!(relative <= result)) result = relative;
  }
  return result;
}

template <class Real, int D>
void step(const Scheme& scheme, double dt, const std::array<double, D>& gravity,
          Particles<Real, D>& particles, int threads = 2) {
  Nodes<Real, D> nodes, before;
  p2g(scheme, particles, dt, nodes, before, threads);
  std::array<double, D> g_dt = gravity;
  for (double& g : g_dt) g *= dt;
  update_nodes(particles, nodes, g_dt);
  if (scheme.musl) {
    Nodes<Real, D> after;
    remap(scheme, particles, dt, nodes, before, after, threads);
    return g2p(scheme, particles, dt, after, before, threads);
  }
  g2p(scheme, particles, dt, nodes, before, threads);
}

template <class Real, int D>
void expect_reference(double tolerance) {
  const Cloud<D> cloud = random_cloud<D>(D == 3 ? 700 : 200, kCell);
  std::array<double, D> gravity{};
  gravity[D - 1] = -9.81;
  for (int order = 0; order <= 3; ++order) {  // 0: 1 with MUSL
    for (const Transfer transfer : kTransfers) {
      for (const Form form : kForms) {
        const Scheme scheme{std::max(order, 1), transfer, form, 30.0, order == 0};
        Cloud<D> expected = cloud;
        const auto material = soft_material();
        for (int k = 0; k < 2; ++k) {
          if (order <= 1) reference_step<1, D>(scheme, material, kDt, gravity, expected);
          if (order == 2) reference_step<2, D>(scheme, material, kDt, gravity, expected);
          if (order == 3) reference_step<3, D>(scheme, material, kDt, gravity, expected);
        }
        auto particles = make_particles<Real, D>(cloud, kCell);
        for (int k = 0; k < 2; ++k) step<Real, D>(scheme, kDt, gravity, particles);
        // Nodes that order 1 hardly reaches divide one small number by another.
        EXPECT_LT(largest_difference<D>(make_cloud(particles), expected),
                  order <= 1 ? 5 * tolerance : tolerance)
            << name(scheme);
      }
    }
  }
}

TEST(MpmGeneral, IsTheFormulas2dDouble) { expect_reference<double, 2>(1e-12); }
TEST(MpmGeneral, IsTheFormulas3dDouble) { expect_reference<double, 3>(1e-12); }
TEST(MpmGeneral, IsTheFormulas2dFloat) { expect_reference<float, 2>(2e-5); }
TEST(MpmGeneral, IsTheFormulas3dFloat) { expect_reference<float, 3>(2e-5); }

// The divergence of the cells around x, each a mean over its corners, by the spline of one order
// less.
template <int kOrder, int D, class Velocity>
double divergence_of_cells(const std::array<double, D>& x, const Velocity& velocity) {
  std::array<transfer::Spline<double, std::max(kOrder - 1, 1)>, D> cells;
  for (std::size_t d = 0; d < D; ++d) {
    cells[d] = transfer::spline<std::max(kOrder - 1, 1)>(x[d] - 0.5);
    if (kOrder == 1) cells[d].first = int(std::floor(x[d])), cells[d].w[0] = 1;
  }
  double sum = 0;
  const int many = int(std::pow(kOrder, D));
  for (int c = 0; c < many; ++c) {
    double weight = 1;
    transfer::Index<D> cell;
    for (int d = 0, rest = c; d < D; ++d, rest /= kOrder) {
      weight *= cells[usize(d)].w[rest % kOrder];
      cell[usize(d)] = cells[usize(d)].first + rest % kOrder;
    }
    for (int corner = 0; corner < 1 << D; ++corner) {
      transfer::Index<D> node = cell;
      for (int d = 0; d < D; ++d) node[usize(d)] += corner >> d & 1;
      for (int d = 0; d < D; ++d) {
        sum += weight * (corner >> d & 1 ? 1 : -1) * velocity(node, d) / (1 << (D - 1));
      }
    }
  }
  return sum;
}

// Any velocities at the nodes: F of metal, which flows at constant volume, grows by the cells'
// divergence, and by C apart from that.
template <int kOrder, int D>
void expect_volume_of_cells() {
  Cloud<D> cloud = random_cloud<D>(D == 3 ? 300 : 100, kCell);
  for (auto& p : cloud) p.F = unit_tensor<D>();
  auto particles = make_particles<double, D>(cloud, kCell);
  ParticleRows<double, D> of_metal = rows(particles, 0);
  const std::size_t entries = of_metal.state.size() / cloud.size();
  for (std::size_t k = cloud.size(); k > 0; --k) {  // no plastic strain
    of_metal.state.insert(of_metal.state.begin() + std::ptrdiff_t(k * entries), 0.0);
  }
  particles.materials = {VonMises{.density = 1000, .mu = 400, .lambda = 600, .yield_stress = 1e6}};
  assign<double, D>(particles, std::span<const ParticleRows<double, D>>(&of_metal, 1),
                    Order::kCells, 2);

  const auto velocity = [](const transfer::Index<D>& node, int d) {
    double phase = d;
    for (std::size_t a = 0; a < D; ++a) phase += double(a + 2) * node[a];
    return std::sin(phase * phase);
  };
  const Scheme scheme{kOrder, Transfer::kApic, Form::kMls};
  Nodes<double, D> nodes, before;
  p2g(scheme, particles, kDt, nodes, before, 2);
  update_nodes(particles, nodes, {}, [&](const transfer::Index<D>& node, double* numbers) {
    for (int d = 0; d < D; ++d) numbers[d] = velocity(node, d);
  });
  g2p(scheme, particles, kDt, nodes, before, 2);
  const Cloud<D> after = make_cloud(particles);
  for (std::size_t k = 0; k < cloud.size(); ++k) {
    double left = divergence_of_cells<kOrder, D>(cloud[k].X, velocity) / kCell;
    for (std::size_t d = 0; d < D; ++d) left -= after[k].C[d][d];
    for (std::size_t i = 0; i < D; ++i) {
      for (std::size_t j = 0; j < D; ++j) {
        const double G = after[k].C[i][j] + (i == j ? left / D : 0);
        EXPECT_NEAR(after[k].F[i][j], (i == j ? 1 : 0) + kDt * G, 1e-13);
      }
    }
  }
}

TEST(MpmGeneral, TakesVolumeFromCells) {
  expect_volume_of_cells<1, 2>(), expect_volume_of_cells<1, 3>();
  expect_volume_of_cells<2, 2>(), expect_volume_of_cells<2, 3>();
  expect_volume_of_cells<3, 2>(), expect_volume_of_cells<3, 3>();
}

// Mass, momentum and angular momentum; of particles with the affine part m eps : (C D) for APIC.
struct Sums {
  double mass = 0;
  Eigen::Vector3d momentum = Eigen::Vector3d::Zero(), angular = Eigen::Vector3d::Zero();
};
template <int D>
Eigen::Vector3d vec3(const double* a) {
  return {a[0], a[1], D == 3 ? a[2] : 0};
}

template <int D>
Sums sums(const Cloud<D>& cloud, const Scheme& scheme) {
  Sums s;
  for (const auto& p : cloud) {
    const double m = soft_material().density * p.volume;
    s.mass += m;
    s.momentum += m * vec3<D>(p.v.data());
    s.angular += m * kCell * vec3<D>(p.X.data()).cross(vec3<D>(p.v.data()));
    if (!is_affine(scheme.transfer)) continue;
    for (std::size_t j = 0; j < D; ++j) {  // sum_j D_j e_j x C e_j
      double moment = scheme.order == 2 ? 1.0 / 4 : 1.0 / 3;
      const double f = p.X[j] - std::floor(p.X[j]);
      if (scheme.order == 1) moment = f * (1 - f);
      Eigen::Vector3d column = Eigen::Vector3d::Zero();
      for (std::size_t i = 0; i < D; ++i) column[long(i)] = p.C[i][j];
      s.angular += m * kCell * kCell * moment * Eigen::Vector3d::Unit(long(j)).cross(column);
    }
  }
  return s;
}
template <int D>
Sums sums(const Particles<double, D>& particles, Nodes<double, D>& nodes, bool velocities) {
  Sums s;
  for (std::int64_t b = 0; b < nodes.blocks(); ++b) {
    const auto block = transfer::BlockKey<D>::unpack(particles.layout.node_keys[std::size_t(b)]);
    for (int n = 0; n < nodes.kNodes; ++n) {
      const double* node = nodes.block(b) + n * transfer::kNodeReals;
      std::array<double, D> x;
      for (int d = D - 1, rest = n; d >= 0; --d, rest /= 4) {
        x[std::size_t(d)] = kCell * (4 * block[std::size_t(d)] + rest % 4);
      }
      const Eigen::Vector3d p = vec3<D>(node) * (velocities ? node[D] : 1);
      s.mass += node[D], s.momentum += p, s.angular += vec3<D>(x.data()).cross(p);
    }
  }
  return s;
}

template <int D>
void expect_conservation() {
  const Cloud<D> cloud = random_cloud<D>(300, kCell);
  for (int order = 1; order <= 3; ++order) {
    for (const Transfer transfer : kTransfers) {
      for (const Form form : kForms) {
        const Scheme scheme{order, transfer, form, 0};
        auto particles = make_particles<double, D>(cloud, kCell);
        Nodes<double, D> nodes, before;
        p2g(scheme, particles, kDt, nodes, before, 2);
        const Sums start = sums<D>(cloud, scheme), grid = sums<D>(particles, nodes, false);
        const double small = 1e-12 * start.mass;  // speeds are about 1 m/s
        SCOPED_TRACE(name(scheme));
        EXPECT_NEAR(grid.mass, start.mass, small);
        EXPECT_LT((grid.momentum - start.momentum).norm(), small);
        // Stress is symmetric, so it exerts no torque by MLS and, summed over a spline whose
        // gradients reproduce linear fields, none in the textbook form either.
        EXPECT_LT((grid.angular - start.angular).norm(), small);

        update_nodes(particles, nodes);
        const Sums moving = sums<D>(particles, nodes, true);
        EXPECT_LT((moving.momentum - grid.momentum).norm(), small);
        g2p(scheme, particles, kDt, nodes, before, 2);
        Cloud<D> after = make_cloud(particles);
        const Sums end = sums<D>(after, scheme);
        EXPECT_LT((end.momentum - grid.momentum).norm(), small);
        // Angular momentum of the velocities where they were gathered.
        for (std::size_t k = 0; k < after.size(); ++k) after[k].X = cloud[k].X;
        const double lost = (sums<D>(after, scheme).angular - grid.angular).norm();
        if (transfer == Transfer::kApic || (transfer == Transfer::kAflip && order > 1)) {
          EXPECT_LT(lost, small);
        } else if (transfer == Transfer::kPic) {
          EXPECT_GT(lost, 1e-4 * start.mass);
        }
      }
    }
  }
}
TEST(MpmGeneral, Conserves2d) { expect_conservation<2>(); }
TEST(MpmGeneral, Conserves3d) { expect_conservation<3>(); }

// FLIP of rate 0 adds what the grid gained: without forces nothing changes, however small the step.
TEST(MpmGeneral, FlipBlendsPerUnitOfTime) {
  Cloud<2> cloud = random_cloud<2>(200, kCell);
  for (auto& p : cloud) p.F = unit_tensor<2>();
  const auto energy = [](const Cloud<2>& c) {
    double sum = 0;
    for (const auto& p : c) sum += p.volume * (p.v[0] * p.v[0] + p.v[1] * p.v[1]);
    return sum;
  };
  // Steps so short that particles stay where they are: only the transfer acts, exp(-rate t) of the
  // part of v that the grid does not see is left.
  const auto after = [&](int steps, double rate) {
    auto particles = make_particles<double, 2>(cloud, kCell);
    const double time = 1e-6;
    for (int k = 0; k < steps; ++k) {
      step<double, 2>({2, Transfer::kFlip, Form::kMls, rate / time}, time / steps, {}, particles);
    }
    return energy(make_cloud(particles));
  };
  const double start = energy(cloud);
  EXPECT_NEAR(after(7, 0) / start, 1, 1e-6);
  EXPECT_LT(after(1, 1) / start, 0.8);
  EXPECT_NEAR(after(40, 1) / after(20, 1), 1, 0.02);
}

// Nodes at the rim run away by textbook forces; particles do not, and their speed is known before
// they move.
TEST(MpmGeneral, SpeedOfParticlesIsKnownBeforeTheyMove) {
  const Cloud<3> cloud = random_cloud<3>(300, kCell);
  for (int order = 1; order <= 3; ++order) {
    const Scheme scheme{order, Transfer::kApic, Form::kTextbook, 0};
    auto particles = make_particles<double, 3>(cloud, kCell);
    Nodes<double, 3> nodes, before;
    p2g(scheme, particles, kDt, nodes, before, 2);
    double fastest_node = 0, fastest = 0;
    update_nodes(particles, nodes, {}, [&](const auto&, const double* node) {
      for (int d = 0; d < 3; ++d) fastest_node = std::max(fastest_node, std::abs(node[d]));
    });
    const double speed = greatest_speed(scheme, particles, nodes, 2);
    g2p(scheme, particles, kDt, nodes, before, 2);
    const Cloud<3> after = make_cloud(particles);
    for (std::size_t k = 0; k < cloud.size(); ++k) {
      for (std::size_t d = 0; d < 3; ++d) {
        fastest = std::max(fastest, std::abs(after[k].X[d] - cloud[k].X[d]) * kCell / kDt);
      }
    }
    EXPECT_NEAR(speed / fastest, 1, 1e-9);
    EXPECT_GT(fastest_node, 2 * fastest);
  }
}

// The same bits for any number of threads, in 2D and 3D, for each scheme.
template <class Real, int D>
void expect_same_bits() {
  const Cloud<D> cloud = random_cloud<D>(2000, kCell);
  std::vector<Scheme> schemes;
  for (const Transfer transfer : kTransfers) {
    schemes.push_back({2, transfer, Form::kTextbook, 1.0});
    schemes.push_back({1, transfer, Form::kTextbook, 1.0, true});
  }
  for (const Scheme& scheme : schemes) {
    std::vector<Real> bits;
    for (int threads = 1; threads <= 4; ++threads) {
      auto particles = make_particles<Real, D>(cloud, kCell);
      for (int k = 0; k < 5; ++k) step<Real, D>(scheme, kDt, {}, particles, threads);
      const auto after = rows(particles, 0);
      std::vector<Real> all = after.state;
      all.insert(all.end(), after.motion.begin(), after.motion.end());
      if (threads == 1) bits = all;
      ASSERT_EQ(std::memcmp(bits.data(), all.data(), all.size() * sizeof(Real)), 0) << threads;
    }
  }
}
TEST(MpmGeneral, SameBitsForAnyNumberOfThreads) {
  expect_same_bits<float, 2>();
  expect_same_bits<float, 3>();
  expect_same_bits<double, 2>();
  expect_same_bits<double, 3>();
}

}  // namespace
}  // namespace substep::mpm
