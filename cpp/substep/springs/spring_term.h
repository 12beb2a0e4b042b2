// Springs between pairs of vertices.
//
// Elastic, with e = x_i - x_j, l = |e|, u = e / l (u = 0 where l = 0: such a spring pulls nowhere):
//   W = k/2 (l - r)^2,   g_i = k (l - r) u,   H_ii = k (u u^T + (1 - r/l) (I - u u^T)).
// The second part of H is negative where the spring is shorter than its rest length r: its
// projection keeps u u^T alone.
//
// H takes the tension T = k (l - r) not as it is but as the last step dx of the minimiser foresaw
// it,
//   T = k (l - r + u . (dx_i - dx_j))   with l and u from before that step,
// which is Newton's method on x and T together (Tournier et al., "Stable constrained dynamics",
// SIGGRAPH 2015; Trusty, Kaufman, Levin, "Mixed variational finite elements for implicit simulation
// of deformables", SIGGRAPH Asia 2022, with T in the place of their stretch). A spring that turns
// by a small angle a in a step gets longer by l a^2 / 2: times a large k that is a force beyond all
// others, gone with the next step, and the H that believed in it would hold all vertices fast.
// Where a step was shortened, T is as it is.
//
// Damped, with u lagged:
//   D = c/2 (u . (v_i - v_j))^2,   g_i = c (u . (v_i - v_j)) u,   H_ii = c u u^T.
#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "substep/springs/term.h"

namespace substep::springs {

struct Springs {
  std::vector<std::int32_t> vertices;  // two each
  std::vector<double> stiffness;       // [N/m]
  std::vector<double> rest_lengths;    // [m]
  std::vector<double> damping;         // [N s/m]; empty: none
};

class SpringTerm : public Term {
 public:
  explicit SpringTerm(std::shared_ptr<const Springs> springs) : springs_(std::move(springs)) {}
  int arity() const override { return 2; }
  std::span<const std::int32_t> vertices() const override { return springs_->vertices; }
  bool difference() const override { return true; }
  double energy(Positions x, std::int64_t begin, std::int64_t end) const override;
  void derivatives(Positions x, std::int64_t begin, std::int64_t end, double kept, Vec3* gradient,
                   Mat3* hessian) const override;
  double curvature_bound(std::int64_t e) const override { return springs_->stiffness[e]; }
  void lag(Positions x) override;
  void follow(Positions x, Positions dx, std::int64_t begin, std::int64_t end) override;

 private:
  std::shared_ptr<const Springs> springs_;
  std::vector<double> tensions_;  // T of each spring [N]
};

class SpringDampingTerm : public Term {
 public:
  explicit SpringDampingTerm(std::shared_ptr<const Springs> springs)
      : springs_(std::move(springs)) {}
  int arity() const override { return 2; }
  std::span<const std::int32_t> vertices() const override { return springs_->vertices; }
  bool difference() const override { return true; }
  bool dissipative() const override { return true; }
  void lag(Positions x) override;
  double energy(Positions v, std::int64_t begin, std::int64_t end) const override;
  void derivatives(Positions v, std::int64_t begin, std::int64_t end, double kept, Vec3* gradient,
                   Mat3* hessian) const override;
  double curvature_bound(std::int64_t e) const override { return springs_->damping[e]; }

 private:
  std::shared_ptr<const Springs> springs_;
  std::vector<Vec3> directions_;
};

}  // namespace substep::springs
