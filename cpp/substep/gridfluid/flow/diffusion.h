// Diffusion of velocities and scalars, implicit: (1 - k L) d = d', with L the sum of differences to
// the neighbours and k = w nu dt / dx^2, by conjugate gradients.
//
// Where the neighbour of a velocity is in an obstacle, which holds it, the difference is that to
// the surface over the part theta of the way to it, as Gibou, Fedkiw, Cheng and Kang, "A
// second-order-accurate symmetric discretization of the Poisson equation on irregular domains",
// 2002, eq. 20; where the obstacle lets the flow slip, there is none. Of scalars, differences count
// by the open part of the face between, so that nothing enters obstacles.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/gridfluid/flow/flow_sides.h"

namespace substep::gridfluid {

struct DiffusionReport {
  int iterations = 0;
  bool converged = true;
};

// The cells, or faces of an axis, that diffusion reaches.
template <class Real, int D>
class Diffusion {
 public:
  // One with other differences than those to all neighbours alike.
  struct Cut {
    std::int64_t index;
    std::array<Real, 2 * D> weight;  // of the difference to each neighbour
    Real to_surface, surface;        // the sum of 1 / theta, and of 1 / theta times what is there
  };

  explicit Diffusion(const Layout<D>& layout) : layout_(layout) {}

  // Of the faces of an axis, in obstacles that hold the flow, or let it slip.
  void find_faces(const SideGhosts<Real, D>& sides, const Obstacles<Real, D>& obstacles,
                  std::size_t axis, bool slip, int threads);
  void find_cells(const Obstacles<Real, D>& obstacles, std::span<const Cell> cells, int threads);

  // Those in obstacles, which it leaves alone.
  std::span<const std::int64_t> fixed() const { return fixed_; }
  const Block<D>& block() const { return block_; }

  // out = L x, 0 at those that are fixed; ghosts of x are filled.
  void apply(std::span<const Real> x, std::span<Real> out, int threads) const;
  // d becomes the solution. refill(x) fills the ghosts of a change x.
  template <class Refill>
  DiffusionReport solve(Real k, std::span<Real> d, const Refill& refill, double tolerance,
                        int max_iterations, int threads);

 private:
  Layout<D> layout_;
  Block<D> block_, plain_;  // of all; of those whose neighbours are in the array
  std::vector<std::int64_t> fixed_;
  std::vector<Cut> cut_;
  AlignedBuffer<Real> r_, p_, q_;

  void spread(Real own, Real factor, bool surfaces, std::span<const Real> x, std::span<Real> out,
              int threads) const;
};

template <class Real, int D>
template <class Refill>
DiffusionReport Diffusion<Real, D>::solve(Real k, std::span<Real> d, const Refill& refill,
                                          double tolerance, int max_iterations, int threads) {
  for (auto* buffer : {&r_, &p_, &q_}) {
    if (buffer->size() == usize(layout_.size)) continue;
    buffer->reset(usize(layout_.size));
    std::fill(buffer->begin(), buffer->end(), Real(0));
  }
  const std::span<Real> r(r_.data(), r_.size()), p(p_.data(), p_.size()), q(q_.data(), q_.size());
  const auto sum = [&](const auto& of) {
    return sum_rows(layout_, block_, threads, [&](std::int64_t begin, std::int64_t end) {
      double part = 0;
      for (std::int64_t i = begin; i < end; ++i) part += double(of(i));
      return part;
    });
  };
  for (const std::int64_t i : fixed_) d[usize(i)] = 0;
  // From d' itself: without diffusion it is the solution.
  const double norm = sum([&](std::int64_t i) { return d[usize(i)] * d[usize(i)]; });
  DiffusionReport report;
  if (!(norm > 0)) return report;
  // Of a copy: faces in sides, where nothing changes, are 0 there.
  for_rows(layout_, block_, threads, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) p[usize(i)] = d[usize(i)];
  });
  refill(p);
  spread(Real(1), -k, false, p, q, threads);
  double rr = sum([&](std::int64_t i) {
    r[usize(i)] = p[usize(i)] = d[usize(i)] - q[usize(i)];
    return r[usize(i)] * r[usize(i)];
  });
  const double goal = tolerance * tolerance * norm;
  while (rr > goal) {
    if (report.iterations == max_iterations) {
      report.converged = false;
      break;
    }
    ++report.iterations;
    refill(p);
    spread(Real(1), -k, false, p, q, threads);
    const double pq = sum([&](std::int64_t i) { return p[usize(i)] * q[usize(i)]; });
    if (!(pq > 0)) break;
    const Real alpha = Real(rr / pq);
    const double next = sum([&](std::int64_t i) {
      d[usize(i)] += alpha * p[usize(i)];
      r[usize(i)] -= alpha * q[usize(i)];
      return r[usize(i)] * r[usize(i)];
    });
    const Real beta = Real(next / rr);
    rr = next;
    for_rows(layout_, block_, threads, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) p[usize(i)] = r[usize(i)] + beta * p[usize(i)];
    });
  }
  return report;
}

extern template class Diffusion<float, 2>;
extern template class Diffusion<float, 3>;
extern template class Diffusion<double, 2>;
extern template class Diffusion<double, 3>;

}  // namespace substep::gridfluid
