#include "substep/mpm/implicit/particles.h"

#include <array>
#include <cmath>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::mpm {
namespace {

using transfer::kArena;

// Increment of H in the differences: its square and the rounding over it are 1e-11 of the modulus.
constexpr double kIncrement = 0x1p-18;

template <int D>
struct Patch {
  alignas(64) Node<D> nodes[D == 3 ? kArena * kArena * kArena : kArena * kArena];
  Patch() : nodes{} {}
};

template <int D>
void load_arena(const ImplicitNodes<D>& nodes, std::size_t block, const double* x,
                Patch<D>& arena) {
  nodes.for_arena(block, [&](int at, std::size_t i) {
    arena.nodes[at] = load<Node<D>>(x + i * kNodeLanes<D>);
  });
}

template <int D>
void add_arena(const ImplicitNodes<D>& nodes, std::size_t block, const Patch<D>& arena, double* y) {
  nodes.for_arena(block, [&](int at, std::size_t i) {
    double* const to = y + i * kNodeLanes<D>;
    const Node<D> sum = load<Node<D>>(to) + arena.nodes[at];
    std::memcpy(to, &sum, sizeof sum);
  });
}

// Four (two) floats as doubles.
template <int D>
SUBSTEP_INLINE Node<D> widened(const float* from) {
  const auto narrow = load<Vector<float, 4 * kNodeLanes<D>>>(from);
  return __builtin_convertvector(narrow, Node<D>);
}

// Columns C : (v g^T) for H = v g^T with column a of H in H[a].
template <int D>
SUBSTEP_INLINE void apply_tangent(const float* C, const Node<D> (&H)[D], Node<D> (&A)[D]) {
  using N = Node<D>;
#pragma GCC unroll 3
  for (int b = 0; b < D; ++b) A[b] = N{};
#pragma GCC unroll 3
  for (int a = 0; a < D; ++a) {
#pragma GCC unroll 3
    for (int j = 0; j < D; ++j, C += D * kNodeLanes<D>) {
      const double h = H[a][j];
#pragma GCC unroll 3
      for (int b = 0; b < D; ++b) A[b] = fma<N>(h, widened<D>(C + b * kNodeLanes<D>), A[b]);
    }
  }
}

}  // namespace

template <int D>
template <class Body>
void ImplicitParticles<D>::for_blocks(const Body& body) {
  parallel_chunks(
      static_cast<std::int64_t>(nodes_->layout->arenas.size()),
      [&](std::int64_t block) { body(usize(block)); }, threads_);
}

template <int D>
template <class Body>
void ImplicitParticles<D>::for_colours(const Body& body) {
  const auto& colours = nodes_->layout->colours;
  std::array<std::int64_t, (1 << D)> chunks;
  for (std::size_t c = 0; c < chunks.size(); ++c) {
    chunks[c] = static_cast<std::int64_t>(colours[c].size());
  }
  parallel_phases(
      chunks,
      [&](std::int64_t colour, std::int64_t k) { body(usize(colours[usize(colour)][usize(k)])); },
      threads_);
}

template <int D>
template <class Pass>
void ImplicitParticles<D>::with_order(const Pass& pass) {
  if (order_ == 1) {
    pass.template operator()<2>();
  } else if (order_ == 2) {
    pass.template operator()<3>();
  } else {
    pass.template operator()<4>();
  }
}

template <int D>
bool ImplicitParticles<D>::hyperelastic() const {
  for (const Group& group : groups_) {
    if (!group.material->hyperelastic()) return false;
  }
  return true;
}

template <int D>
template <class Real>
void ImplicitParticles<D>::assign(const Particles<Real, D>& particles,
                                  const ImplicitNodes<D>& nodes, int order, Form form, double dt,
                                  int threads) {
  nodes_ = &nodes;
  order_ = order;
  threads_ = threads;
  dt_ = dt;
  scale_ = dt / particles.cell;
  groups_.clear();
  groups_.resize(particles.groups.size());
  const std::size_t blocks = nodes.layout->arenas.size();
  energies_.assign(blocks, 0);
  for (std::size_t g = 0; g < groups_.size(); ++g) {
    const ParticleGroup<Real, D>& from = particles.groups[g];
    Group& to = groups_[g];
    to.material = implicit_material<D>(particles.materials[g]);
    to.fields = to.material->fields();
    to.first.resize(blocks);
    to.count.resize(blocks);
    std::int64_t packets = 0;
    for (std::size_t b = 0; b < blocks; ++b) {
      to.first[b] = packets;
      to.count[b] = from.runs[b].count;
      packets += (from.runs[b].count + kLanesD - 1) / kLanesD;
    }
    const auto size = usize(packets);
    to.state.resize(size * usize(to.fields));
    to.volume.resize(size);
    to.H.resize(size * kGradient);
    to.A.resize(size * kGradient);
    to.stencils.resize(size * kLanesD);
    to.tangent.resize(size * kLanesD * kTangent);
    for_blocks([&](std::size_t b) {
      const int count = to.count[b];
      const int packets_here = (count + kLanesD - 1) / kLanesD;
      for (int q = 0; q < packets_here * kLanesD; ++q) {
        const int source = q < count ? q : count - 1;
        const std::int64_t packet = from.runs[b].first + source / kLanes<Real>;
        const int at = source % kLanes<Real>;
        const auto value = [&](int f) {
          return static_cast<double>(from.packet(packet)[f * kLanes<Real> + at]);
        };
        const std::size_t into = usize(to.first[b]) + usize(q / kLanesD);
        const int lane = q % kLanesD;
        double x[D];
        for (int d = 0; d < D; ++d) x[d] = value(d);
        const Real volume = from.volume[usize(packet * kLanes<Real> + at)];
        to.volume[into][lane] = q < count ? static_cast<double>(volume) : 0;
        for (int f = 0; f < to.fields; ++f) {
          to.state[into * usize(to.fields) + usize(f)][lane] = value(D + f);
        }
        ImplicitStencil<D>& s = to.stencils[into * kLanesD + usize(lane)];
        s = order == 1   ? implicit_stencil<D, 1>(x, form)
            : order == 2 ? implicit_stencil<D, 2>(x, form)
                         : implicit_stencil<D, 3>(x, form);
      }
      for (int p = 0; p < packets_here && particles.trial; ++p) {
        to.material->admit(to.state.data() + usize(to.first[b] + p) * usize(to.fields),
                           particles.before);
      }
    });
  }
}

template <int D>
double ImplicitParticles<D>::evaluate(std::span<const double> v) {
  with_order([&]<int K>() {
    for_blocks([&](std::size_t b) {
      Patch<D> arena;
      load_arena(*nodes_, b, v.data(), arena);
      V energy{};
      for (Group& group : groups_) {
        const auto first = usize(group.first[b]);
        const int packets = (group.count[b] + kLanesD - 1) / kLanesD;
        for (int p = 0; p < packets; ++p) {
          const std::size_t packet = first + usize(p);
          V H[2][kGradient], A[2][kGradient], psi[2];
          for (int lane = 0; lane < kLanesD; ++lane) {
            Node<D> columns[D];
            gather<K>(arena.nodes, group.stencils[packet * kLanesD + usize(lane)], columns);
            for (int k = 0; k < kGradient; ++k) H[0][k][lane] = scale_ * columns[k % D][k / D];
          }
          for (int k = 0; k < kGradient; ++k) H[1][k] = H[0][k];
          group.material->stress(group.state.data() + packet * usize(group.fields), H, dt_, A, psi);
          for (int k = 0; k < kGradient; ++k) {
            group.H[packet * kGradient + usize(k)] = H[0][k];
            group.A[packet * kGradient + usize(k)] = A[0][k];
          }
          energy += group.volume[packet] * psi[0];
        }
      }
      double sum = 0;
      for (int lane = 0; lane < kLanesD; ++lane) sum += energy[lane];
      energies_[b] = sum;
    });
  });
  return sum_of_blocks();
}

template <int D>
double ImplicitParticles<D>::sum_of_blocks() const {
  double sum = 0;
  for (const double energy : energies_) sum += energy;
  return sum;
}

template <int D>
void ImplicitParticles<D>::add_gradient(std::span<double> r) {
  with_order([&]<int K>() {
    for_colours([&](std::size_t b) {
      Patch<D> arena;
      for (const Group& group : groups_) {
        const auto first = usize(group.first[b]);
        for (int q = 0; q < group.count[b]; ++q) {
          const std::size_t packet = first + usize(q / kLanesD);
          const int lane = q % kLanesD;
          const V* const A = group.A.data() + packet * kGradient;
          const double volume = scale_ * group.volume[packet][lane];
          Node<D> columns[D] = {};
          for (int k = 0; k < kGradient; ++k) columns[k % D][k / D] = volume * A[k][lane];
          scatter<K>(arena.nodes, group.stencils[packet * kLanesD + usize(lane)], columns);
        }
      }
      add_arena(*nodes_, b, arena, r.data());
    });
  });
}

template <int D>
void ImplicitParticles<D>::linearise() {
  for_blocks([&](std::size_t b) {
    double stiffness = 0;
    for (Group& group : groups_) {
      const bool symmetric = group.material->hyperelastic();
      const auto first = usize(group.first[b]);
      const int packets = (group.count[b] + kLanesD - 1) / kLanesD;
      for (int p = 0; p < packets; ++p) {
        const std::size_t packet = first + usize(p);
        const V* const at = group.H.data() + packet * kGradient;
        const V scale = group.volume[packet] * (scale_ * scale_ / (2 * kIncrement));
        V C[kGradient][kGradient];  // C[c][r]: dA_r / dH_c
        for (int c = 0; c < kGradient; ++c) {
          V H[2][kGradient], A[2][kGradient], psi[2];
          for (int k = 0; k < kGradient; ++k) H[0][k] = H[1][k] = at[k];
          H[0][c] += kIncrement;
          H[1][c] -= kIncrement;
          group.material->stress(group.state.data() + packet * usize(group.fields), H, dt_, A, psi);
          for (int k = 0; k < kGradient; ++k) C[c][k] = scale * (A[0][k] - A[1][k]);
        }
        for (int c = 0; c < kGradient && symmetric; ++c) {
          for (int k = 0; k < c; ++k) C[c][k] = C[k][c] = 0.5 * (C[c][k] + C[k][c]);
        }
        for (int lane = 0; lane < kLanesD; ++lane) {
          stiffness += std::abs(C[0][0][lane]) / (scale_ * scale_);
          float* const to = group.tangent.data() + (packet * kLanesD + usize(lane)) * kTangent;
          for (int c = 0; c < kGradient; ++c) {
            const int column = c % D * D + c / D;  // H_ja as a D + j
            for (int k = 0; k < kGradient; ++k) {
              to[(column * D + k % D) * kNodeLanes<D> + k / D] = static_cast<float>(C[c][k][lane]);
            }
          }
        }
      }
    }
    energies_[b] = stiffness;
  });
  stiffness_ = sum_of_blocks();
}

template <int D>
void ImplicitParticles<D>::add_product(std::span<const double> x, std::span<double> y) {
  with_order([&]<int K>() {
    for_colours([&](std::size_t b) {
      Patch<D> from, to;
      load_arena(*nodes_, b, x.data(), from);
      for (const Group& group : groups_) {
        const std::size_t first = usize(group.first[b]) * kLanesD;
        for (int q = 0; q < group.count[b]; ++q) {
          const std::size_t particle = first + usize(q);
          const ImplicitStencil<D>& s = group.stencils[particle];
          Node<D> H[D], A[D];
          gather<K>(from.nodes, s, H);
          apply_tangent<D>(group.tangent.data() + particle * kTangent, H, A);
          scatter<K>(to.nodes, s, A);
        }
      }
      add_arena(*nodes_, b, to, y.data());
    });
  });
}

// Block of node i: B_jl = sum_ab g_a C_(ja)(lb) g_b; row l of it (B is symmetric but for plastic
// flow) is a vector over j.
template <int D>
void ImplicitParticles<D>::add_diagonal(std::span<double> blocks) {
  constexpr int kArenaNodes = D == 3 ? kArena * kArena * kArena : kArena * kArena;
  for_colours([&](std::size_t b) {
    std::vector<Node<D>> arena(usize(kArenaNodes * D), Node<D>{});
    for (const Group& group : groups_) {
      const std::size_t first = usize(group.first[b]) * kLanesD;
      for (int q = 0; q < group.count[b]; ++q) {
        const std::size_t particle = first + usize(q);
        const ImplicitStencil<D>& s = group.stencils[particle];
        Node<D> C[D * D * D];
        for (int k = 0; k < D * D * D; ++k) {
          C[k] = widened<D>(group.tangent.data() + particle * kTangent + k * kNodeLanes<D>);
        }
        int k[D];
        for (int n = 0; n < (D == 3 ? 64 : 16); ++n) {
          int at = s.first, stride = 1;
          bool inside = true;
          for (int d = D - 1; d >= 0; --d, stride *= kArena) {
            k[d] = n >> (2 * (D - 1 - d)) & 3;
            inside = inside && k[d] <= order_;
            at += k[d] * stride;
          }
          if (!inside) continue;
          double g[D];
          node_gradient<D>(s, k, g);
          for (int l = 0; l < D; ++l) {
            Node<D> sum{};
            for (int e = 0; e < D; ++e) {
              Node<D> part{};
              for (int a = 0; a < D; ++a) part += g[a] * C[(e * D + l) * D + a];
              sum += g[e] * part;
            }
            arena[usize(at * D + l)] += sum;
          }
        }
      }
    }
    nodes_->for_arena(b, [&](int at, std::size_t i) {
      for (int l = 0; l < D; ++l) {
        for (int j = 0; j < D; ++j) {
          blocks[i * D * kNodeLanes<D> + usize(l * kNodeLanes<D> + j)] +=
              arena[usize(at * D + l)][j];
        }
      }
    });
  });
}

template class ImplicitParticles<2>;
template class ImplicitParticles<3>;
#define SUBSTEP_ASSIGN(Real, D)                                                                  \
  template void ImplicitParticles<D>::assign(const Particles<Real, D>&, const ImplicitNodes<D>&, \
                                             int, Form, double, int);
SUBSTEP_ASSIGN(float, 2)
SUBSTEP_ASSIGN(float, 3)
SUBSTEP_ASSIGN(double, 2)
SUBSTEP_ASSIGN(double, 3)
#undef SUBSTEP_ASSIGN

}  // namespace substep::mpm
