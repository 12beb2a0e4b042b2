"""Linear stability: how a method multiplies the solution of a linear equation in one step.

One-step methods on y' = lambda y give y_{n+1} = R(z) y_n, z = h lambda. R of the stabilised method
depends on its stages: "RKC2(s)" has s of them, "RKC2" alone ten. Methods for x'' = a give
(x, v / omega)_{n+1} = M (x, v / omega)_n on x'' = -omega^2 x - 2 zeta omega v. Where |R(z)|, or the
largest |eigenvalue| of M, exceeds 1, the numbers grow although the solution does not.

References
----------
[HW] E. Hairer, G. Wanner, "Solving Ordinary Differential Equations II", 2nd ed., Springer 1996.
[HLW] E. Hairer, C. Lubich, G. Wanner, "Geometric Numerical Integration", 2nd ed., Springer 2006.
"""

from .analysis import (
    Region,
    amplification,
    amplification_polynomial,
    imaginary_limit,
    max_stable_step,
    one_step_methods,
    real_limit,
    region,
    stiffness_ratio,
)
from .oscillator import (
    amplification_eigenvalues,
    amplification_matrix,
    second_order_methods,
    stability_limit,
)
from .plotting import plot

__all__ = [
    "Region",
    "amplification",
    "amplification_eigenvalues",
    "amplification_matrix",
    "amplification_polynomial",
    "imaginary_limit",
    "max_stable_step",
    "one_step_methods",
    "plot",
    "real_limit",
    "region",
    "second_order_methods",
    "stability_limit",
    "stiffness_ratio",
]


def __dir__() -> list[str]:
    return __all__
