// Vectors of three numbers in four lanes, of which the last is 0, and matrices of such columns.
#pragma once

#include "substep/core/point_lanes.h"
#include "substep/rigid/shapes/pose.h"

namespace substep::rigid {

using Quad3 = Quad<double>;

SUBSTEP_INLINE Quad3 quad(double x, double y, double z) { return Quad3{x, y, z, 0}; }
SUBSTEP_INLINE Quad3 quad(const Vec3& v) { return Quad3{v[0], v[1], v[2], 0}; }
SUBSTEP_INLINE Quad3 quad(const Point<double>& p) { return Quad3{p.x, p.y, p.z, 0}; }
SUBSTEP_INLINE Vec3 vec(const Quad3& v) { return {v[0], v[1], v[2]}; }

SUBSTEP_INLINE double dot(const Quad3& a, const Quad3& b) {
  const Quad3 c = a * b;
  return c[0] + c[1] + c[2];
}
// The same in all lanes, sooner.
SUBSTEP_INLINE Quad3 dot_lanes(const Quad3& a, const Quad3& b) {
  const Quad3 c = a * b;
  return __builtin_shufflevector(c, c, 0, 0, 0, 0) + __builtin_shufflevector(c, c, 1, 1, 1, 1) +
         __builtin_shufflevector(c, c, 2, 2, 2, 2);
}
SUBSTEP_INLINE Quad3 cross(const Quad3& a, const Quad3& b) {
  const auto next = [](const Quad3& v) __attribute__((always_inline)) {
    return __builtin_shufflevector(v, v, 1, 2, 0, 3);
  };
  return next(a * next(b) - next(a) * b);
}

struct QuadMatrix {
  Quad3 column[3];

  Quad3& operator[](int k) { return column[k]; }
  const Quad3& operator[](int k) const { return column[k]; }

  static QuadMatrix identity() { return {quad(1, 0, 0), quad(0, 1, 0), quad(0, 0, 1)}; }
  static QuadMatrix of(const Mat3& A) {
    return {quad(Vec3(A.col(0))), quad(Vec3(A.col(1))), quad(Vec3(A.col(2)))};
  }
  Mat3 dense() const {
    Mat3 A;
    for (int k = 0; k < 3; ++k) A.col(k) = vec(column[k]);
    return A;
  }
};

SUBSTEP_INLINE Quad3 operator*(const QuadMatrix& A, const Quad3& v) {
  return A[0] * v[0] + A[1] * v[1] + A[2] * v[2];
}
SUBSTEP_INLINE QuadMatrix operator*(const QuadMatrix& A, const QuadMatrix& B) {
  return {A * B[0], A * B[1], A * B[2]};
}
SUBSTEP_INLINE QuadMatrix operator+(const QuadMatrix& A, const QuadMatrix& B) {
  return {A[0] + B[0], A[1] + B[1], A[2] + B[2]};
}
SUBSTEP_INLINE QuadMatrix operator-(const QuadMatrix& A, const QuadMatrix& B) {
  return {A[0] - B[0], A[1] - B[1], A[2] - B[2]};
}
// a b^T
SUBSTEP_INLINE QuadMatrix outer(const Quad3& a, const Quad3& b) {
  return {a * b[0], a * b[1], a * b[2]};
}
SUBSTEP_INLINE QuadMatrix transpose(const QuadMatrix& A) {
  const Quad3 low = __builtin_shufflevector(A[0], A[1], 0, 4, 2, 6);
  const Quad3 high = __builtin_shufflevector(A[0], A[1], 1, 5, 3, 7);
  return {__builtin_shufflevector(low, A[2], 0, 1, 4, 7),
          __builtin_shufflevector(high, A[2], 0, 1, 5, 7),
          __builtin_shufflevector(low, A[2], 2, 3, 6, 7)};
}
// A^T v
SUBSTEP_INLINE Quad3 transposed_product(const QuadMatrix& A, const Quad3& v) {
  return transpose(A) * v;
}
// [d] A: the vector product of d with each column.
SUBSTEP_INLINE QuadMatrix cross(const Quad3& d, const QuadMatrix& A) {
  return {cross(d, A[0]), cross(d, A[1]), cross(d, A[2])};
}
// A [d]
SUBSTEP_INLINE QuadMatrix cross(const QuadMatrix& A, const Quad3& d) {
  return {d[2] * A[1] - d[1] * A[2], d[0] * A[2] - d[2] * A[0], d[1] * A[0] - d[0] * A[1]};
}
SUBSTEP_INLINE QuadMatrix cross_matrix(const Quad3& d) {
  return {quad(0, d[2], -d[1]), quad(-d[2], 0, d[0]), quad(d[1], -d[0], 0)};
}
SUBSTEP_INLINE QuadMatrix inverse(const QuadMatrix& A) {
  const Quad3 x = cross(A[1], A[2]), y = cross(A[2], A[0]), z = cross(A[0], A[1]);
  const double scale = 1 / dot(A[0], x);
  return transpose({scale * x, scale * y, scale * z});
}

}  // namespace substep::rigid
