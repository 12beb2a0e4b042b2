// 3-vectors and 3x3 matrices over a scalar T: double, or a vector of lanes (lanes.h), so that one
// formula serves a single element and eight at a time. Decompositions are branch-free in the lanes:
// the bits of a lane do not depend on its neighbours.
#pragma once

#include <cmath>
#include <type_traits>

#include "substep/core/lanes.h"

namespace substep {

template <class T>
struct Vector3 {
  T v[3];
  SUBSTEP_INLINE T& operator[](int i) { return v[i]; }
  SUBSTEP_INLINE const T& operator[](int i) const { return v[i]; }
};

template <class T>
struct Matrix3 {
  T m[3][3];
  SUBSTEP_INLINE T& operator()(int i, int j) { return m[i][j]; }
  SUBSTEP_INLINE const T& operator()(int i, int j) const { return m[i][j]; }
  SUBSTEP_INLINE Vector3<T> column(int j) const { return {{m[0][j], m[1][j], m[2][j]}}; }
  SUBSTEP_INLINE void set_column(int j, const Vector3<T>& c) {
    m[0][j] = c[0], m[1][j] = c[1], m[2][j] = c[2];
  }
  static SUBSTEP_INLINE Matrix3 identity() {
    Matrix3 I{};
    for (int i = 0; i < 3; ++i) I.m[i][i] += 1;
    return I;
  }
};

// mask ? a : b, lane by lane.
template <class Mask, class T>
SUBSTEP_INLINE T select(const Mask& mask, const T& a, const T& b) {
  return mask ? a : b;
}

template <class T>
SUBSTEP_INLINE T square_root(const T& a) {
  if constexpr (std::is_floating_point_v<T>) {
    return std::sqrt(a);
  } else {
    T r;
    for (unsigned lane = 0; lane < sizeof(T) / sizeof(a[0]); ++lane) r[lane] = std::sqrt(a[lane]);
    return r;
  }
}

template <class T>
SUBSTEP_INLINE T dot(const Vector3<T>& a, const Vector3<T>& b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

template <class T>
SUBSTEP_INLINE Vector3<T> cross(const Vector3<T>& a, const Vector3<T>& b) {
  return {{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]}};
}

template <class T>
SUBSTEP_INLINE Vector3<T> operator*(const T& s, const Vector3<T>& a) {
  return {{s * a[0], s * a[1], s * a[2]}};
}
template <class T>
SUBSTEP_INLINE Vector3<T> operator-(const Vector3<T>& a, const Vector3<T>& b) {
  return {{a[0] - b[0], a[1] - b[1], a[2] - b[2]}};
}
template <class T>
SUBSTEP_INLINE Vector3<T> operator+(const Vector3<T>& a, const Vector3<T>& b) {
  return {{a[0] + b[0], a[1] + b[1], a[2] + b[2]}};
}

template <class T>
SUBSTEP_INLINE Matrix3<T> operator*(const Matrix3<T>& A, const Matrix3<T>& B) {
  Matrix3<T> C;
#pragma GCC unroll 3
  for (int i = 0; i < 3; ++i) {
#pragma GCC unroll 3
    for (int j = 0; j < 3; ++j) {
      C.m[i][j] = A.m[i][0] * B.m[0][j] + A.m[i][1] * B.m[1][j] + A.m[i][2] * B.m[2][j];
    }
  }
  return C;
}

template <class T>
SUBSTEP_INLINE Matrix3<T> transpose(const Matrix3<T>& A) {
  Matrix3<T> B;
#pragma GCC unroll 3
  for (int i = 0; i < 3; ++i) {
#pragma GCC unroll 3
    for (int j = 0; j < 3; ++j) B.m[i][j] = A.m[j][i];
  }
  return B;
}

template <class T>
SUBSTEP_INLINE Vector3<T> operator*(const Matrix3<T>& A, const Vector3<T>& b) {
  Vector3<T> c;
#pragma GCC unroll 3
  for (int i = 0; i < 3; ++i) c[i] = A.m[i][0] * b[0] + A.m[i][1] * b[1] + A.m[i][2] * b[2];
  return c;
}

// a A + b B
template <class T>
SUBSTEP_INLINE Matrix3<T> combine(const T& a, const Matrix3<T>& A, const T& b,
                                  const Matrix3<T>& B) {
  Matrix3<T> C;
#pragma GCC unroll 3
  for (int i = 0; i < 3; ++i) {
#pragma GCC unroll 3
    for (int j = 0; j < 3; ++j) C.m[i][j] = a * A.m[i][j] + b * B.m[i][j];
  }
  return C;
}

// A : B
template <class T>
SUBSTEP_INLINE T inner(const Matrix3<T>& A, const Matrix3<T>& B) {
  T sum = A.m[0][0] * B.m[0][0];
#pragma GCC unroll 9
  for (int k = 1; k < 9; ++k) sum += A.m[k / 3][k % 3] * B.m[k / 3][k % 3];
  return sum;
}

// The cofactor matrix, d det(A) / dA: its columns are a1 x a2, a2 x a0, a0 x a1.
template <class T>
SUBSTEP_INLINE Matrix3<T> cofactor(const Matrix3<T>& A) {
  Matrix3<T> C;
  C.set_column(0, cross(A.column(1), A.column(2)));
  C.set_column(1, cross(A.column(2), A.column(0)));
  C.set_column(2, cross(A.column(0), A.column(1)));
  return C;
}

// A = U diag(sigma) V^T with rotations U and V, sigma[0] >= sigma[1] >= |sigma[2]|, and the sign of
// det A in sigma[2] (Irving, Teran, Fedkiw, "Invertible finite elements for robust simulation of
// large deformation", SCA 2004). NaN in A gives NaN, after a bounded number of sweeps.
template <class T>
struct Svd3 {
  Matrix3<T> U;
  Vector3<T> sigma;
  Matrix3<T> V;
};

namespace detail {

// Columns p and q of M become c p - s q and s p + c q.
template <class T>
SUBSTEP_INLINE void rotate_columns(Matrix3<T>& M, int p, int q, const T& c, const T& s) {
#pragma GCC unroll 3
  for (int i = 0; i < 3; ++i) {
    const T a = M.m[i][p];
    M.m[i][p] = c * a - s * M.m[i][q];
    M.m[i][q] = s * a + c * M.m[i][q];
  }
}

// tan(theta) of the smaller rotation that diagonalises [[a, g], [g, b]] (Golub, Van Loan, "Matrix
// computations", 4th ed., section 8.5.2), free of 0/0; 0 where `done`.
template <class T, class Mask>
SUBSTEP_INLINE T jacobi_tangent(const T& a, const T& b, const T& g, const Mask& done) {
  const T zero{}, d = b - a;
  const T size = select(d < zero, -d, d) + square_root(d * d + 4.0 * (g * g));
  const T t = select(d < zero, -2.0 * g, 2.0 * g) / select(done, zero + 1.0, size);
  return select(done, zero, t);
}

template <class Mask>
SUBSTEP_INLINE bool any_lane(const Mask& mask) {
  if constexpr (std::is_same_v<Mask, bool>) {
    return mask;
  } else {
    return any(mask);
  }
}

inline constexpr int kPairs[3][2] = {{0, 1}, {0, 2}, {1, 2}};
inline constexpr int kMaxSweeps = 16;  // three or four are typical

// Jacobi's method converges cubically: a lane is done after the sweep that starts with all angles
// below kCoarse, and rotations below kFine are left out (squares of sines).
inline constexpr double kCoarse = 1e-12, kFine = 1e-31;

// A unit vector perpendicular to the unit vector a.
template <class T>
SUBSTEP_INLINE Vector3<T> perpendicular(const Vector3<T>& a) {
  const T zero{};
  const auto along_x = a[0] * a[0] > zero + 0.5;
  const Vector3<T> b{
      {select(along_x, -a[1], zero), select(along_x, a[0], -a[2]), select(along_x, zero, a[1])}};
  const T norm = square_root(dot(b, b));
  return (1.0 / norm) * b;
}

}  // namespace detail

// One-sided Jacobi (Hestenes): columns of A V are rotated in pairs until they are orthogonal, which
// keeps small singular values accurate; U follows by Gram-Schmidt.
template <class T>
SUBSTEP_INLINE Svd3<T> svd3(const Matrix3<T>& A) {
  const T zero{};
  Matrix3<T> B = A, V = Matrix3<T>::identity();
  auto finished = zero != zero;
  for (int sweep = 0; sweep < detail::kMaxSweeps; ++sweep) {
    auto fine = zero == zero, coarse = fine;
#pragma GCC unroll 3
    for (const auto& [p, q] : detail::kPairs) {
      const Vector3<T> x = B.column(p), y = B.column(q);
      const T g = dot(x, y), size = dot(x, x) * dot(y, y);
      fine &= !(g * g > detail::kFine * size);
      coarse &= !(g * g > detail::kCoarse * size);
    }
    finished |= fine;
    if (!detail::any_lane(!finished)) break;
#pragma GCC unroll 3
    for (const auto& [p, q] : detail::kPairs) {
      const Vector3<T> x = B.column(p), y = B.column(q);
      const T a = dot(x, x), b = dot(y, y), g = dot(x, y);
      const auto done = finished | !(g * g > detail::kFine * (a * b));
      const T t = detail::jacobi_tangent(a, b, g, done);
      const T c = 1.0 / square_root(1.0 + t * t), s = t * c;
      detail::rotate_columns(B, p, q, c, s);
      detail::rotate_columns(V, p, q, c, s);
    }
    finished |= coarse;
  }
#pragma GCC unroll 3
  for (const auto& [p, q] : detail::kPairs) {
    const Vector3<T> x = B.column(p), y = B.column(q);
    const auto swap = dot(x, x) < dot(y, y);
    const T c = select(swap, zero, zero + 1.0), s = select(swap, zero - 1.0, zero);
    detail::rotate_columns(B, p, q, c, s);
    detail::rotate_columns(V, p, q, c, s);
  }
  const auto direction = [&](const Vector3<T>& b, const Vector3<T>& fallback) {
    const T square = dot(b, b);
    const auto vanishes = square < zero + 1e-290;
    const T scale = 1.0 / square_root(select(vanishes, zero + 1.0, square));
    Vector3<T> u;
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) u[i] = select(vanishes, fallback[i], scale * b[i]);
    return u;
  };
  const Vector3<T> b0 = B.column(0), b1 = B.column(1);
  const Vector3<T> u0 = direction(b0, {{zero + 1.0, zero, zero}});
  const Vector3<T> u1 = direction(b1 - dot(u0, b1) * u0, detail::perpendicular(u0));
  const Vector3<T> u2 = cross(u0, u1);
  Svd3<T> out;
  out.U.set_column(0, u0);
  out.U.set_column(1, u1);
  out.U.set_column(2, u2);
  out.sigma = {{dot(u0, b0), dot(u1, b1), dot(u2, B.column(2))}};
  out.V = V;
  return out;
}

// The nearest positive semidefinite matrix to a symmetric one: negative eigenvalues become 0.
template <class T>
SUBSTEP_INLINE Matrix3<T> positive_part(const Matrix3<T>& A) {
  const T zero{};
  const T minor = A(0, 0) * A(1, 1) - A(0, 1) * A(0, 1);
  const Matrix3<T> cof = cofactor(A);
  const T det = A(0, 0) * cof(0, 0) + A(0, 1) * cof(0, 1) + A(0, 2) * cof(0, 2);
  const auto positive = (A(0, 0) > zero) & (minor > zero) & (det > zero);  // Sylvester
  if (!detail::any_lane(!positive)) return A;
  // One rotation in the plane of p and q, r being the third: D_pq becomes 0.
  T d[3] = {A(0, 0), A(1, 1), A(2, 2)}, off[3] = {A(1, 2), A(0, 2), A(0, 1)};  // off[r]: D_pq
  Matrix3<T> W = Matrix3<T>::identity();
  auto finished = positive;
  for (int sweep = 0; sweep < detail::kMaxSweeps; ++sweep) {
    const T size = inner(A, A), rest = off[0] * off[0] + off[1] * off[1] + off[2] * off[2];
    finished |= !(rest > detail::kFine * size);
    if (!detail::any_lane(!finished)) break;
    const auto coarse = !(rest > detail::kCoarse * size);
#pragma GCC unroll 3
    for (const auto& [p, q] : detail::kPairs) {
      const int r = 3 - p - q;
      const T g = off[r];
      const auto done = finished | !(g * g > detail::kFine * size);
      const T t = detail::jacobi_tangent(d[p], d[q], g, done);
      const T c = 1.0 / square_root(1.0 + t * t), s = t * c;
      d[p] -= t * g;
      d[q] += t * g;
      off[r] = select(done, g, zero);
      const T rp = off[q], rq = off[p];  // D_rp, D_rq
      off[q] = c * rp - s * rq;
      off[p] = s * rp + c * rq;
      detail::rotate_columns(W, p, q, c, s);
    }
    finished |= coarse;
  }
  Matrix3<T> P;
#pragma GCC unroll 3
  for (int i = 0; i < 3; ++i) {
#pragma GCC unroll 3
    for (int j = 0; j < 3; ++j) {
      T sum{};
#pragma GCC unroll 3
      for (int k = 0; k < 3; ++k) {
        sum += select(d[k] > zero, d[k], zero) * W(i, k) * W(j, k);
      }
      P(i, j) = select(positive, A(i, j), sum);
    }
  }
  return P;
}

}  // namespace substep
