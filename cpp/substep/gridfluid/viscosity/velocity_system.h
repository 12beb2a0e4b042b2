// The linear system of an implicit viscosity: symmetric and positive definite, a row for each face
// whose velocity is to be found.
//
// Conjugate gradients in double, preconditioned by a V-cycle: sweeps of Gauss-Seidel over the rows
// forwards, rigid motions of blocks of cells (rigid_blocks.h), and as many backwards. Rows of one
// colour do not meet, so that sweeps are the same bits for any number of threads.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "substep/core/usize.h"
#include "substep/gridfluid/viscosity/rigid_blocks.h"
#include "substep/gridfluid/viscosity/velocity_rows.h"

namespace substep::gridfluid {

struct ViscosityReport {
  int iterations = 0;
  bool converged = true, finite = true;
};

// Of a body whose velocity V is found as well. K: the second derivatives of the energy by V and the
// rows; with those by V alone and the mobility V changes by C (g - K x), for the derivative -g at
// x = 0, which leaves A - K^T C K of the system for the rows.
template <int D>
struct BodyOfRows {
  static constexpr int kMotions = D == 2 ? 3 : 6;
  using Motion = Eigen::Matrix<double, kMotions, 1>;
  using Mobility = Eigen::Matrix<double, kMotions, kMotions>;

  std::vector<std::pair<std::int32_t, Motion>> k;  // by rows
  Mobility c;
  Motion g = Motion::Zero();

  void join() {  // those of one row
    std::stable_sort(k.begin(), k.end(),
                     [](const auto& a, const auto& b) { return a.first < b.first; });
    std::size_t n = 0;
    for (const auto& [row, motion] : k) {
      if (n > 0 && k[n - 1].first == row) {
        k[n - 1].second += motion;
      } else {
        k[n++] = {row, motion};
      }
    }
    k.resize(n);
  }
  Motion product(std::span<const double> x) const {  // K x
    Motion sum = Motion::Zero();
    for (const auto& [row, motion] : k) sum += motion * x[usize(row)];
    return sum;
  }
  void subtract(const Motion& motion, std::span<double> y) const {  // y -= K^T motion
    for (const auto& [row, of_row] : k) y[usize(row)] -= of_row.dot(motion);
  }
};

template <int D>
class VelocitySystem {
 public:
  VelocityRows<D> rows;
  std::vector<BodyOfRows<D>> bodies;

  // x from 0 on; stops where the energy of the error, x . A x of it, is about `goal`.
  ViscosityReport solve(std::span<const double> b, std::span<double> x, double goal,
                        int max_iterations, int threads);

 private:
  void precondition(int threads);
  void sweep(bool forwards, int threads);

  RigidBlocks<D> blocks_;
  std::vector<double> r_, z_, d_, q_;
};

extern template class VelocitySystem<2>;
extern template class VelocitySystem<3>;

}  // namespace substep::gridfluid
