"""Viscosity, XSPH, vorticity confinement and surface tension of position-based fluids."""

from __future__ import annotations

import numpy as np
import pytest
import substep
from substep import InputError, PositionBasedFluid

D = 0.001


def ball(radius: float, d: float = D) -> np.ndarray:
    x = substep.fill_box([-radius] * 3, [radius] * 3, d)
    return x[np.linalg.norm(x, axis=1) < radius]


def axes(x: np.ndarray) -> np.ndarray:
    """Half axes of the ellipsoid of the same second moments, ascending."""
    y = x - x.mean(axis=0)
    return np.sqrt(5 * np.linalg.eigvalsh(y.T @ y / len(y)))


def momenta(fluid: PositionBasedFluid) -> tuple[np.ndarray, np.ndarray]:
    values = fluid.diagnostics()
    return tuple(np.array([values[f"{name}_{a}"] for a in "xyz"]) for name in NAMES)  # type: ignore


NAMES = ("momentum", "angular_momentum")


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("xsph", -0.1),
        ("xsph", 1.5),
        ("xsph", np.nan),
        ("viscosity", -1.0),
        ("viscosity", np.inf),
        ("viscosity", [0.1, 0.2]),
        ("vorticity_confinement", -1.0),
        ("vorticity_confinement", np.inf),
        ("surface_tension", -0.01),
        ("surface_tension", np.nan),
    ],
)
def test_bad_coefficients_are_refused(argument, value):
    with pytest.raises(InputError, match=argument):
        PositionBasedFluid(np.zeros((1, 3)), D, **{argument: value})


@pytest.mark.parametrize(
    "terms",
    [
        {"xsph": 0.3},
        {"viscosity": 1e-3},
        {"viscosity": [1e-2, 0.0]},
        {"vorticity_confinement": 1.0},
        {"surface_tension": 0.07},
    ],
    ids=lambda terms: next(iter(terms)),
)
def test_each_term_conserves_momentum(terms):
    """Two fluids of unlike mass in free flight; to the rounding of float64."""
    x = ball(6 * D)
    rng = np.random.default_rng(3)
    v = rng.normal(0, 0.02, x.shape) + np.array([0.3, -0.1, 0.2])
    fluid = PositionBasedFluid(
        x,
        D,
        velocities=v,
        density=[1000.0, 300.0],
        fluid=(x[:, 0] > 0).astype(int),
        gravity=(0, 0, 0),
        dtype="float64",
        **terms,
    )
    before = momenta(fluid)[0]
    for _ in range(10):
        fluid.step(2e-4)
    np.testing.assert_allclose(momenta(fluid)[0], before, rtol=0, atol=1e-10 * abs(before).max())
