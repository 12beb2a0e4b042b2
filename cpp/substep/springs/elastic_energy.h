// Isotropic hyperelastic energies Psi(F) per rest volume [Pa], over doubles or lanes.
//
// Each model gives Psi, the stress P = dPsi/dF, and the curvature in the frame of the singular
// values: with F = U diag(s) V^T (svd3), Psi is a function psi(s) of s alone, and the 9 x 9 Hessian
// d2Psi/dF2 has a basis of eigenvectors that the model does not enter (Smith, de Goes, Kim,
// "Analytic eigensystems for isotropic distortion energies", ACM TOG 38(1), 2019, sections 4-5):
//
//   scaling     U e_i e_i^T V^T, i = 0..2, mixed by the 3 x 3 matrix A_ij = d2 psi / ds_i ds_j
//   flip k      U (e_i e_j^T + e_j e_i^T) V^T / sqrt(2):  (psi_i - psi_j) / (s_i - s_j)
//   twist k     U (e_i e_j^T - e_j e_i^T) V^T / sqrt(2):  (psi_i + psi_j) / (s_i + s_j)
//
// where psi_i = dpsi/ds_i and {i, j, k} = {0, 1, 2}. For polynomials of s the divisions are carried
// out, so that equal and vanishing s need no care. The formulas hold for s of either sign, and so
// for inverted elements.
#pragma once

#include "substep/core/matrix3.h"

namespace substep::springs {

template <class T>
struct PrincipalCurvature {
  Matrix3<T> A;
  Vector3<T> flip, twist;
};

// mu = E / (2 (1 + nu)), lambda = E nu / ((1 + nu) (1 - 2 nu)) [Pa]
template <class T>
struct Lame {
  T mu, lambda;
};

// log(1 + a)
template <class T>
SUBSTEP_INLINE T log_one_plus(const T& a) {
  if constexpr (std::is_floating_point_v<T>) {
    return std::log1p(a);
  } else {
    T r;
    for (unsigned lane = 0; lane < sizeof(T) / sizeof(a[0]); ++lane) r[lane] = std::log1p(a[lane]);
    return r;
  }
}

// E = (F^T F - 1) / 2
template <class T>
SUBSTEP_INLINE Matrix3<T> green_strain(const Matrix3<T>& F) {
  return combine<T>(T{} + 0.5, transpose(F) * F, T{} - 0.5, Matrix3<T>::identity());
}

// Stable neo-Hookean (Smith, de Goes, Kim, "Stable neo-Hookean flesh simulation", ACM TOG 37(2),
// 2018, eq. 14), finite for every F, inverted ones too; its rest state F = I is a minimum, and the
// collapsed F = 0 is not:
//
//   Psi = m/2 (I - 3) + l/2 (J - a)^2 - m/2 log(I + 1),   I = |F|^2,  J = det F
//   m = 4/3 mu,  l = lambda + 5/6 mu   (section 3.4: the linear elasticity of mu and lambda)
//   a = 1 + 3/4 m / l                  (no stress at F = I)
//
// With k = m (1 - 1 / (I + 1)), dk/dI = m / (I + 1)^2 and d = l (J - a):
//   P    = k F + d cof F
//   psi_i = k s_i + d s_j s_k
//   A_ii = k + 2 dk/dI s_i^2 + l (s_j s_k)^2
//   A_ij = 2 dk/dI s_i s_j + l (s_j s_k)(s_i s_k) + d s_k
//   flip_k = k - d s_k,   twist_k = k + d s_k

// Psi is measured from the rest state, and so that rounding does not hide small strains from the
// line search: with Green's strain E, its trace t and j = J - 1,
//   Psi - Psi(1) = m (3/4 (t - j) + t/4 - 1/2 log(1 + t/2)) + l/2 j^2,
// where both differences are of second order. J^2 = det(1 + 2 E) = 1 + 2 t + r gives, for J > 0,
//   j = (2 t + r) / (J + 1),   t - j = (t j - r) / (J + 1),   r = 4 tr(cof E) + 8 det E.
struct StableNeoHookean {
  static constexpr const char* kName = "neo_hookean";

  template <class T>
  struct Constants {
    T m, l, a;
    explicit SUBSTEP_INLINE Constants(const Lame<T>& c)
        : m(4.0 / 3.0 * c.mu), l(c.lambda + 5.0 / 6.0 * c.mu), a(1.0 + 0.75 * m / l) {}
  };

  template <class T>
  static SUBSTEP_INLINE T energy(const Matrix3<T>& F, const Lame<T>& lame) {
    const Constants<T> c(lame);
    const Matrix3<T> E = green_strain(F), cof = cofactor(E);
    const T t = E(0, 0) + E(1, 1) + E(2, 2);
    const T J = dot(F.column(0), cross(F.column(1), F.column(2)));
    const T rest =
        4.0 * (cof(0, 0) + cof(1, 1) + cof(2, 2)) + 8.0 * dot(E.column(0), cof.column(0));
    const auto upright = J > T{} + 0.5;
    const T sum = select(upright, J + 1.0, T{} + 1.0);
    const T j = select(upright, (2.0 * t + rest) / sum, J - 1.0);
    const T t_minus_j = select(upright, (t * j - rest) / sum, t - j);
    return c.m * (0.75 * t_minus_j + 0.25 * t - 0.5 * log_one_plus<T>(0.5 * t)) + 0.5 * c.l * j * j;
  }

  template <class T>
  static SUBSTEP_INLINE Matrix3<T> stress(const Matrix3<T>& F, const Lame<T>& lame) {
    const Constants<T> c(lame);
    const Matrix3<T> cof = cofactor(F);
    const T I = inner(F, F), J = dot(F.column(0), cof.column(0));
    return combine<T>(c.m * (I / (I + 1.0)), F, c.l * (J - c.a), cof);
  }

  template <class T>
  static SUBSTEP_INLINE PrincipalCurvature<T> curvature(const Vector3<T>& s, const Lame<T>& lame) {
    const Constants<T> c(lame);
    const T I = dot(s, s), J = s[0] * s[1] * s[2];
    const T k = c.m * (I / (I + 1.0)), d = c.l * (J - c.a);
    const T dk2 = 2.0 * c.m / ((I + 1.0) * (I + 1.0));
    PrincipalCurvature<T> H;
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3, n = (i + 2) % 3;
      const T cof_i = s[j] * s[n], cof_j = s[i] * s[n];
      H.A(i, i) = k + dk2 * s[i] * s[i] + c.l * cof_i * cof_i;
      H.A(i, j) = H.A(j, i) = dk2 * s[i] * s[j] + c.l * cof_i * cof_j + d * s[n];
      H.flip[i] = k - d * s[i];
      H.twist[i] = k + d * s[i];
    }
    return H;
  }
};

// St. Venant-Kirchhoff, linear elasticity in the Green strain E = (F^T F - 1) / 2 (Bonet, Wood,
// "Nonlinear continuum mechanics for finite element analysis", 2nd ed., 2008, eq. 6.35):
//
//   Psi = mu |E|^2 + lambda/2 (tr E)^2,   S = 2 mu E + lambda tr E,   P = F S
//   psi_i = s_i (mu (s_i^2 - 1) + lambda t),   t = tr E = (|s|^2 - 3) / 2
//   A_ii = mu (3 s_i^2 - 1) + lambda (t + s_i^2),   A_ij = lambda s_i s_j
//   flip_k  = mu (s_i^2 + s_i s_j + s_j^2 - 1) + lambda t
//   twist_k = mu (s_i^2 - s_i s_j + s_j^2 - 1) + lambda t
//
// It softens under compression (a bar's stress peaks at a stretch of 1 / sqrt(3)), vanishes at
// collapse, and takes a reflected element for one at rest: E does not see the sign of det F.
struct StVenantKirchhoff {
  static constexpr const char* kName = "st_venant_kirchhoff";

  template <class T>
  static SUBSTEP_INLINE T energy(const Matrix3<T>& F, const Lame<T>& c) {
    const Matrix3<T> E = green_strain(F);
    const T trace = E(0, 0) + E(1, 1) + E(2, 2);
    return c.mu * inner(E, E) + 0.5 * c.lambda * trace * trace;
  }

  template <class T>
  static SUBSTEP_INLINE Matrix3<T> stress(const Matrix3<T>& F, const Lame<T>& c) {
    const Matrix3<T> E = green_strain(F);
    const T trace = E(0, 0) + E(1, 1) + E(2, 2);
    return F * combine<T>(2.0 * c.mu, E, c.lambda * trace, Matrix3<T>::identity());
  }

  template <class T>
  static SUBSTEP_INLINE PrincipalCurvature<T> curvature(const Vector3<T>& s, const Lame<T>& c) {
    const T lambda_t = 0.5 * c.lambda * (dot(s, s) - 3.0);
    PrincipalCurvature<T> H;
#pragma GCC unroll 3
    for (int k = 0; k < 3; ++k) {
      const int i = (k + 1) % 3, j = (k + 2) % 3;
      const T square = s[i] * s[i] + s[j] * s[j] - 1.0, product = s[i] * s[j];
      H.A(k, k) = c.mu * (3.0 * s[k] * s[k] - 1.0) + lambda_t + c.lambda * s[k] * s[k];
      H.A(i, j) = H.A(j, i) = c.lambda * product;
      H.flip[k] = c.mu * (square + product) + lambda_t;
      H.twist[k] = c.mu * (square - product) + lambda_t;
    }
    return H;
  }
};

// The list of models: function(name, model) for each, until one returns true.
template <class Function>
bool any_model(Function&& function) {
  return function(StableNeoHookean::kName, StableNeoHookean{}) ||
         function(StVenantKirchhoff::kName, StVenantKirchhoff{});
}

// P + kept (H - P), where P is the positive semidefinite part of the curvature H.
template <class T>
SUBSTEP_INLINE PrincipalCurvature<T> filter(const PrincipalCurvature<T>& H, double kept) {
  if (kept == 1.0) return H;
  const T zero{}, fraction = zero + kept;
  const auto clamp = [&](const T& e) { return select(e < zero, fraction * e, e); };
  PrincipalCurvature<T> P;
  P.A = combine<T>(1.0 - fraction, positive_part(H.A), fraction, H.A);
#pragma GCC unroll 3
  for (int k = 0; k < 3; ++k) {
    P.flip[k] = clamp(H.flip[k]);
    P.twist[k] = clamp(H.twist[k]);
  }
  return P;
}

// The bilinear form of d2Psi/dF2 between the gradients g and h of two shape functions: the 3 x 3
// matrix K with u^T K w = (u g^T) : H : (w h^T). In the frame of the singular values, with
// p = V^T g and q = V^T h,
//   K_ii = A_ii p_i q_i + sum_j (flip_k + twist_k)/2 p_j q_j,   j != i
//   K_ij = A_ij p_i q_j + (flip_k - twist_k)/2 p_j q_i
// and K = U K U^T in space.
template <class T>
SUBSTEP_INLINE Matrix3<T> principal_block(const PrincipalCurvature<T>& H, const Vector3<T>& p,
                                          const Vector3<T>& q) {
  Matrix3<T> K;
#pragma GCC unroll 3
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    K(i, i) = H.A(i, i) * p[i] * q[i] + 0.5 * (H.flip[k] + H.twist[k]) * p[j] * q[j] +
              0.5 * (H.flip[j] + H.twist[j]) * p[k] * q[k];
    const T mixed = 0.5 * (H.flip[k] - H.twist[k]);
    K(i, j) = H.A(i, j) * p[i] * q[j] + mixed * p[j] * q[i];
    K(j, i) = H.A(i, j) * p[j] * q[i] + mixed * p[i] * q[j];
  }
  return K;
}

}  // namespace substep::springs
