// Materials with usual constants, and packets of them whose lanes are set in double precision.
#pragma once

#include <Eigen/Dense>
#include <cmath>
#include <cstring>
#include <random>
#include <string>
#include <type_traits>
#include <variant>
#include <vector>

#include "substep/core/usize.h"
#include "substep/mpm/materials/materials.h"

namespace substep::mpm {

inline constexpr double kMu = 4e4, kLambda = 6e4;  // [Pa]

// By name, what materials are given here; other constants stay what their struct says.
struct Constants {
  double density = 1000;
  double mu = kMu, lambda = kLambda;
  double bulk_modulus = 1e5, viscosity = 5;
  double yield_stress = 1e3, consistency = 20, flow_index = 0.6;
};
template <class M>
M usual(const Constants& c = {}) {
  M m{};
  m.density = c.density;
  if constexpr (requires { m.mu; }) m.mu = c.mu;
  if constexpr (requires { m.lambda; }) m.lambda = c.lambda;
  if constexpr (requires { m.bulk_modulus; }) m.bulk_modulus = c.bulk_modulus;
  if constexpr (requires { m.viscosity; }) m.viscosity = c.viscosity;
  if constexpr (requires { m.yield_stress; }) m.yield_stress = c.yield_stress;
  if constexpr (requires { m.consistency; }) m.consistency = c.consistency;
  if constexpr (requires { m.flow_index; }) m.flow_index = c.flow_index;
  return m;
}

// One of each, in the order of the list, each denser than the one before it.
inline std::vector<AnyMaterial> one_of_each(Constants c = {}) {
  std::vector<AnyMaterial> all;
  for_each_material([&]<class M>(std::type_identity<M>) {
    all.push_back(usual<M>(c));
    c.density += 100;
  });
  return all;
}

inline std::string name_of(const AnyMaterial& material) {
  return std::visit([](const auto& m) { return std::string(m.kName); }, material);
}

using Matrix3d = Eigen::Matrix3d;
using Vector3d = Eigen::Vector3d;

// Uniform in [-1, 1].
template <class Random>
Matrix3d random_matrix(Random& random, int D = 3) {
  std::uniform_real_distribution<double> uniform(-1, 1);
  Matrix3d A = Matrix3d::Zero();
  for (int i = 0; i < D; ++i) {
    for (int j = 0; j < D; ++j) A(i, j) = uniform(random);
  }
  return A;
}

template <class Random>
Matrix3d random_rotation(Random& random, int D = 3) {
  std::uniform_real_distribution<double> uniform(-1, 1);
  const Eigen::Vector3d axis =
      D == 3 ? Eigen::Vector3d(uniform(random), uniform(random), uniform(random)).normalized()
             : Eigen::Vector3d::UnitZ();
  return Eigen::AngleAxisd(3 * uniform(random), axis).toRotationMatrix();
}

template <class T>
inline constexpr int kWidth = kVectorBytes / static_cast<int>(sizeof(T));

// A matrix (in 2D with zz alone out of the plane) as tensor, in one lane.
template <class T, int D>
void set(Tensor<Vector<T>, D>& A, int lane, const Matrix3d& values) {
  for (int i = 0; i < D; ++i) {
    for (int j = 0; j < D; ++j) A(i, j)[lane] = static_cast<T>(values(i, j));
  }
  if (D == 2) A.m[4][lane] = static_cast<T>(values(2, 2));
}
template <class V, int D>
Matrix3d get(const Tensor<V, D>& A, int lane) {
  Matrix3d values = Matrix3d::Zero();
  for (int i = 0; i < D; ++i) {
    for (int j = 0; j < D; ++j) values(i, j) = A(i, j)[lane];
  }
  if (D == 2) values(2, 2) = A.diagonal(2)[lane];
  return values;
}
template <class V, int D>
Matrix3d get(const SymmetricTensor<V, D>& A, int lane) {
  Matrix3d values = Matrix3d::Zero();
  for (int i = 0; i < D; ++i) {
    for (int j = 0; j < D; ++j) values(i, j) = A(i, j)[lane];
  }
  values(2, 2) = A.m[2][lane];
  return values;
}

inline Matrix3d deviator(const Matrix3d& A) { return A - A.trace() / 3 * Matrix3d::Identity(); }
inline double pressure(const Matrix3d& A) { return -A.trace() / 3; }
inline Matrix3d diagonal(double x, double y, double z) { return Vector3d(x, y, z).asDiagonal(); }
inline Matrix3d shear_rate(double rate) {
  Matrix3d G = Matrix3d::Zero();
  G(0, 1) = rate;
  return G;
}

// tau and F of principal stretches sigma and principal stresses, for F = U diag(trial) V^T.
struct Decomposed {
  Eigen::JacobiSVD<Matrix3d> svd;
  explicit Decomposed(const Matrix3d& F) : svd(F, Eigen::ComputeFullU | Eigen::ComputeFullV) {}
  Vector3d sigma() const { return svd.singularValues(); }
  Matrix3d tensor(const Vector3d& t) const {
    return svd.matrixU() * t.asDiagonal() * svd.matrixU().transpose();
  }
  Matrix3d deformation(const Vector3d& s) const {
    return svd.matrixU() * s.asDiagonal() * svd.matrixV().transpose();
  }
};

inline Vector3d hencky_stress(const Vector3d& eps) {
  return 2 * kMu * eps + Vector3d::Constant(kLambda * eps.sum());
}

// One packet of a material.
template <class M, class T = double, int D = 3>
struct Packet {
  using V = Vector<T>;
  static constexpr int kFields = M::template kFields<D>, kLanes = kWidth<T>;
  static constexpr int kOwn = kFields - static_cast<int>(M::kState.size());  // the first of kState

  M material = usual<M>();
  V fields[kFields];
  SymmetricTensor<V, D> tau{};

  Packet() {
    const auto rest = initial_fields<M, D>();
    for (int f = 0; f < kFields; ++f) {
      fields[f] = splat<V>(static_cast<T>(rest[usize(f)]));
    }
  }
  // The deformation F in one lane: J where that is all the material knows.
  void deform(int lane, const Matrix3d& F) {
    if constexpr (M::kHasF) {
      auto A = Tensor<V, D>::load(fields);
      set<T, D>(A, lane, F);
      A.store(fields);
    } else {
      fields[0][lane] = static_cast<T>(F.determinant());
    }
  }
  void deform(const Matrix3d& F) {
    for (int lane = 0; lane < kLanes; ++lane) deform(lane, F);
  }
  Matrix3d F(int lane = 0) const { return get(Tensor<V, D>::load(fields), lane); }
  double own(int k, int lane = 0) const { return fields[kOwn + k][lane]; }

  void advance(const Matrix3d& G, double dt) {
    Tensor<V, D> all{};
    for (int lane = 0; lane < kLanes; ++lane) set<T, D>(all, lane, G);
    material.template advance<V, D>(fields, all, static_cast<T>(dt));
  }
  void stress(double dt = 0, const Matrix3d& G = Matrix3d::Zero()) {
    Tensor<V, D> all[1] = {};
    for (int lane = 0; lane < kLanes; ++lane) set<T, D>(all[0], lane, G);
    V* const of[1] = {fields};
    SymmetricTensor<V, D> result[1];
    material.template stress<V, D, 1>(of, all, static_cast<T>(dt), result);
    tau = result[0];
  }
  Matrix3d stress_of(int lane = 0) const { return get(tau, lane); }
  double energy(int lane = 0) const { return material.template energy_density<V, D>(fields)[lane]; }
  double modulus(int lane = 0) const { return material.template wave_modulus<V, D>(fields)[lane]; }
};

}  // namespace substep::mpm
