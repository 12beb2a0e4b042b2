// A term of an energy: a sum over elements (springs, tetrahedra, contacts) of few vertices each.
// Terms know formulas only; sums, the sparse matrix, threads and time belong to
// incremental_potential.h. An elastic term is a function W(x) of positions. A dissipative term is a
// Rayleigh function D(v) of velocities, in directions and amounts that lag() takes from positions:
// its force is -dD/dv, so damping is a force, whatever integrates it.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <span>

namespace substep::springs {

using Vec3 = Eigen::Vector3d;
using Mat3 = Eigen::Matrix3d;
using Positions = std::span<const Vec3>;

class Term {
 public:
  virtual ~Term() = default;

  // The vertices of all elements, arity() each, fixed for the life of the term, unless it roves.
  virtual int arity() const = 0;
  virtual std::span<const std::int32_t> vertices() const = 0;
  // Whether its elements, of one vertex each, are others at other positions: those that count,
  // which find() looks for. lists() tells how often they changed; energies are summed by parts,
  // which part_end() ends for element e, if `grain` are one.
  virtual bool roves() const { return false; }
  virtual void find(Positions /*x*/) {}
  virtual std::int64_t lists() const { return 0; }
  virtual std::int64_t part_end(std::int64_t /*e*/, std::int64_t /*grain*/) const {
    return static_cast<std::int64_t>(vertices().size());
  }

  // Whether elements of two vertices depend on x_a - x_b alone: then derivatives() writes the
  // gradient and the Hessian block of a only; those of b follow: g_b = -g_a, H_ab = -H_aa.
  virtual bool difference() const { return false; }

  // Whether this is D(v) rather than W(x).
  virtual bool dissipative() const { return false; }
  // At the start of a step: fixes the directions of D(v), and what follow() carries on.
  virtual void lag(Positions /*x*/) {}
  // The minimiser goes from x to x + dx: forces that the Hessian takes as they were foreseen, for
  // the elements [begin, end).
  virtual void follow(Positions /*x*/, Positions /*dx*/, std::int64_t /*begin*/,
                      std::int64_t /*end*/) {}

  // For D(v): the minimiser begins at velocities v, or has come there.
  virtual void arrive(Positions /*v*/, std::int64_t /*begin*/, std::int64_t /*end*/) {}

  // The sum over the elements [begin, end); infinity where the energy is not defined.
  virtual double energy(Positions x, std::int64_t begin, std::int64_t end) const = 0;

  // Gradients of the elements [begin, end): arity() vectors each. Hessians, unless `hessian` is
  // null: blocks d2E/dx_a dx_b for a >= b, at a (a + 1) / 2 + b. `kept` in [0, 1] is the fraction
  // of negative curvature that is kept: 1 is the true Hessian, 0 its positive semidefinite
  // projection P, and between them H = P + kept (H_true - P). Both arrays start at element `begin`.
  virtual void derivatives(Positions x, std::int64_t begin, std::int64_t end, double kept,
                           Vec3* gradient, Mat3* hessian) const = 0;

  // A number b that bounds the curvature of element e everywhere: H <= b I for the block of a
  // difference() or of a single vertex. Infinity: none is known.
  virtual double curvature_bound(std::int64_t /*e*/) const {
    return std::numeric_limits<double>::infinity();
  }

  // The largest step s in (0, 1] for which x + s dx is allowed (nothing penetrates or inverts).
  virtual double step_bound(Positions /*x*/, Positions /*dx*/, std::int64_t /*begin*/,
                            std::int64_t /*end*/) const {
    return 1.0;
  }
};

// Elements of a term, and blocks of the Hessian that derivatives() writes for each.
inline std::int64_t element_count(const Term& term) {
  return static_cast<std::int64_t>(term.vertices().size()) / term.arity();
}
inline int gradient_count(const Term& term) { return term.difference() ? 1 : term.arity(); }
inline int block_count(const Term& term) {
  return term.difference() ? 1 : term.arity() * (term.arity() + 1) / 2;
}

}  // namespace substep::springs
