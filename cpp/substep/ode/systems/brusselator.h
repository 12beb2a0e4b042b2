// The Brusselator with diffusion on a line and on a periodic square, by second differences.
// Equations, symbols, sources: python/substep/ode/systems/stiff.py. The state is planar:
// all u, then all v.
#pragma once

#include <memory>
#include <mutex>

#include "substep/ode/implicit/jacobian.h"
#include "substep/ode/stepping/system.h"

namespace substep::ode {

// The reaction and its Jacobian: u' = a + u^2 v - (b + 1) u, v' = b u - u^2 v.
struct BrusselatorReaction {
  double a, b;

  [[gnu::always_inline]] double u(double u, double v) const {
    return a + u * u * v - (b + 1.0) * u;
  }
  [[gnu::always_inline]] double v(double u, double v) const { return b * u - u * u * v; }
  double uu(double u, double v) const { return 2.0 * u * v - (b + 1.0); }
  double uv(double u) const { return u * u; }
  double vu(double u, double v) const { return b - 2.0 * u * v; }
  double vv(double u) const { return -u * u; }
};

// What the two have in common: a sparse Jacobian with the diffusion constant between neighbours.
class Brusselator : public System {
 public:
  std::int64_t size() const final { return 2 * cells_; }
  bool has_jacobian() const final { return true; }
  const SparsePattern* jacobian_pattern() const final;
  void jacobian(double t, const double* y, double* values) final;
  bool has_jacobian_product() const final { return true; }
  double spectral_radius(double t, const double* y) final;
  bool polls() const final { return true; }

 protected:
  // `neighbours` of an inner cell; c is the diffusion constant over the mesh width squared.
  Brusselator(std::int64_t cells, int neighbours, double c, BrusselatorReaction reaction)
      : cells_(cells), neighbours_(neighbours), c_(c), reaction_(reaction) {}

  // Writes the cell and its neighbours, rising, and returns how many there are.
  virtual int stencil(std::int64_t cell, std::int32_t* cells) const = 0;

  std::int64_t cells_;
  int neighbours_;
  double c_;
  BrusselatorReaction reaction_;

 private:
  mutable std::once_flag once_;
  mutable std::unique_ptr<SparsePattern> pattern_;
};

class Brusselator1D final : public Brusselator {
 public:
  Brusselator1D(std::int64_t n, double alpha, double a, double b);

  void rhs(double t, const double* y, double* dydt) override;
  bool rkc_stage(const RkcStage& stage) override;
  void jacobian_product(double t, const double* y, const double* v, double* out) override;

 private:
  int stencil(std::int64_t cell, std::int32_t* cells) const override;
  template <class Use>
  void for_cells(const double* y, double u_end, double v_end, int threads, Use&& use) const;
};

class Brusselator2D final : public Brusselator {
 public:
  Brusselator2D(std::int64_t n, double alpha, double a, double b, double source,
                double source_time);

  void rhs(double t, const double* y, double* dydt) override;
  bool rkc_stage(const RkcStage& stage) override;
  void jacobian_product(double t, const double* y, const double* v, double* out) override;

 private:
  int stencil(std::int64_t cell, std::int32_t* cells) const override;
  template <class Use>
  void for_rows(const double* y, int threads, Use&& use) const;
  template <class Store>
  void evaluate(double t, const double* y, int threads, Store&& store) const;

  struct Range {
    std::int64_t begin, end;
  };
  std::int64_t n_;
  double source_, source_time_;
  std::vector<Range> disc_;  // cells of each row that the source feeds
};

}  // namespace substep::ode
