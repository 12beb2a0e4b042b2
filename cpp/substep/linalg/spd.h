// The nearest positive semidefinite matrix: local Hessians are projected before they are assembled,
// so that Newton's direction descends (Teran, Sifakis, Irving, Fedkiw, "Robust quasistatic finite
// elements and flesh simulation", SCA 2005, section 5).
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

namespace substep {

// H = Q diag(lambda) Q^T -> Q diag(max(lambda, floor)) Q^T, for N = 3, 9, 12, ...; returns whether
// anything was changed. Only the lower triangle of H is read.
template <int N>
bool project_spd(Eigen::Matrix<double, N, N>& h, double floor = 0) {
  using Matrix = Eigen::Matrix<double, N, N>;
  const Matrix shifted = h - floor * Matrix::Identity();
  if (Eigen::LLT<Matrix>(shifted).info() == Eigen::Success) return false;  // most of them
  const Eigen::SelfAdjointEigenSolver<Matrix> eigen(h);
  if (eigen.eigenvalues()[0] >= floor) return false;
  h = eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(floor).asDiagonal() *
      eigen.eigenvectors().transpose();
  return true;
}

}  // namespace substep
