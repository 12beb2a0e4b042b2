// Jacobi's elliptic functions and the integral of the third kind, for the motion of a free body.
#pragma once

namespace substep::rigid {

struct Jacobi {
  double sn, cn, dn;
  double K;  // quarter period: the complete integral of the first kind
};

// Of the argument u, for the complementary modulus kc^2 = 1 - k^2 in (0, 1], which is known to full
// precision where k tends to 1. Descending Landen transformations by the arithmetic-geometric mean:
// Bulirsch 1965, "Numerical calculation of elliptic integrals and elliptic functions",
// Numer. Math. 7, procedure sncndn.
Jacobi jacobi(double u, double kc2);

// Carlson's R_J(x, y, z, p) for 0 <= x, y, z <= p, at most one of x, y, z 0, z > 0.
double carlson_rj(double x, double y, double z, double p);

}  // namespace substep::rigid
