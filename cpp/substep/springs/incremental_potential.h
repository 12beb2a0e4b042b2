// The function that a step of implicit Euler minimises (Martin et al., "Example-based elastic
// materials", SIGGRAPH 2011, eq. 2; Li et al., "Incremental potential contact", SIGGRAPH 2020,
// eq. 2), with elastic terms W and dissipative terms D (term.h):
//
//   E(x) = 1/(2 h^2) |x - y|_M^2 + sum W(x) + h sum D((x - x_n) / h),
//   y = x_n + h v_n + h^2 (g + f / m),
//
// so that grad E = 0 is M (x - y) / h^2 = -dW/dx - dD/dv: forces at the end of the step. Pinned
// vertices keep the positions they are given: their gradient is 0, their rows those of the
// identity.
//
// Where the step has bodies that yield (bodies.h), their unknowns follow the vertices in all arrays
// of positions and gradients, and border the Hessian.
//
// Elements write into arrays of their own; each vertex and each block of the matrix then gathers
// its contributions in the order of terms and elements, so bits do not depend on threads.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "substep/springs/bodies.h"
#include "substep/springs/term.h"

namespace substep::springs {

// The lower triangle, by columns (compressed sparse columns, rows sorted) with 3 x 3 blocks: column
// 3 i + c holds rows 3 i + c .. 3 i + 2, then three rows for each neighbour j > i.
struct BlockPattern {
  std::vector<std::int32_t> starts;      // first neighbour of each vertex, n + 1 entries
  std::vector<std::int32_t> neighbours;  // j > i, sorted
  std::vector<std::int32_t> columns;     // 3 n + 1
  std::vector<std::int32_t> rows;
  std::int64_t vertices() const { return static_cast<std::int64_t>(starts.size()) - 1; }
};

class IncrementalPotential {
 public:
  // masses [kg], one per vertex; pinned: 1 where a vertex is held. With `bodies` the last two terms
  // are those of their contact.
  IncrementalPotential(std::span<const double> masses, std::span<const std::uint8_t> pinned,
                       std::vector<std::shared_ptr<Term>> terms, int threads = 0,
                       std::unique_ptr<Bodies> bodies = {});
  IncrementalPotential(const IncrementalPotential&) = delete;
  IncrementalPotential& operator=(const IncrementalPotential&) = delete;

  std::int64_t vertices() const { return static_cast<std::int64_t>(masses_.size()); }
  const BlockPattern& pattern() const { return pattern_; }
  std::span<const double> masses() const { return masses_; }
  std::span<const std::uint8_t> pinned() const { return pinned_; }
  std::span<const std::shared_ptr<Term>> terms() const { return terms_; }
  Positions target() const { return y_; }  // y of the present step
  double step() const { return h_; }       // h
  void set_pinned(std::span<const std::uint8_t> pinned);
  void set_threads(int threads) { threads_ = threads; }
  int threads() const { return threads_; }
  Bodies* bodies() { return bodies_.get(); }  // null without colliders

  // Moves bodies to where x says.
  void place(Positions x) {
    if (has_bodies(x)) bodies_->place(unknowns(x));
  }

  // Starts a step of length h [s] from x_n towards y: dissipative terms lag at x_n.
  void begin_step(Positions x_n, Positions y, double h);

  double energy(Positions x);
  // What energy(x) is good to, as x and y are rounded.
  double energy_rounding(Positions x) const;
  void gradient(Positions x, std::span<Vec3> g);
  // Gradient, and Hessian as the values of pattern() and border(); `kept` as in Term::derivatives.
  void assemble(Positions x, double kept, std::span<Vec3> g, std::span<double> values);
  const Border& border() const { return border_; }
  // The minimiser goes from x to x + dx (Term::follow).
  void follow(Positions x, Positions dx);
  // The minimiser begins, or has come, where energy() was asked for last (Term::arrive).
  void arrive();
  // The largest step in (0, 1] along dx that all terms allow.
  double step_bound(Positions x, Positions dx) const;

  // For explicit integrators: f = -dW/dx(x) - dD/dv(v), dissipative terms lagging at x itself.
  void forces(Positions x, Positions v, std::span<Vec3> f);
  // The sum of W(x), for diagnostics.
  double elastic_energy(Positions x);

 private:
  void build_pattern();
  void build_sources();
  // Elements of terms that rove, at x.
  void find_elements(Positions x);
  // What is in x after the vertices.
  Positions unknowns(Positions x) const { return x.subspan(masses_.size()); }
  bool has_bodies(Positions x) const { return x.size() > masses_.size(); }
  void set_velocity(Positions x);
  ContactElements contact_elements() const;
  void evaluate(Positions x, Positions v, double kept, bool hessian);
  double sum_energies(const Term& term, Positions x) const;
  void gather_gradient(std::span<Vec3> g, Positions x) const;
  void gather_blocks(std::span<double> values) const;

  std::vector<double> masses_;
  std::vector<std::uint8_t> pinned_;
  std::vector<std::shared_ptr<Term>> terms_;
  int threads_;
  BlockPattern pattern_;

  double h_ = 0.0;
  std::vector<Vec3> x_n_, y_, velocity_;

  std::vector<std::int64_t> gradient_base_, block_base_;  // of each term, in the arrays below
  std::vector<Vec3> element_gradients_;
  std::vector<Mat3> element_blocks_;
  // What vertex i gathers is listed in [gradient_starts_[i], gradient_starts_[i + 1]); the same for
  // its blocks: that of the diagonal at starts[i] + i, then those of its neighbours.
  std::vector<std::int64_t> gradient_starts_, block_starts_;
  std::vector<std::int64_t> gradient_sources_, block_sources_;  // 4 times the index, and how
  // Terms that rove are the last ones. Of them: the state of their lists, and what vertex i gathers
  // after the others, as it is: places beyond the gradients and blocks of those.
  std::size_t fixed_;
  std::vector<std::int64_t> lists_;
  std::vector<std::int64_t> roving_starts_, roving_sources_;
  std::unique_ptr<Bodies> bodies_;
  Border border_;
};

}  // namespace substep::springs
