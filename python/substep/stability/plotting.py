"""The picture of stability regions (matplotlib, the extra [plot])."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_real
from ..base.imports import needs
from ..errors import InputError
from .analysis import Region, region, spectrum_of

# Okabe and Ito's colours, told apart by colour-blind readers too.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")


def plot(
    methods: str | list[str] | tuple[str, ...],
    eigenvalues: ArrayLike | None = None,
    step: float | None = None,
    ax: Any = None,
) -> Any:
    r"""Draw stability regions, and where a spectrum lies in them.

    Parameters
    ----------
    methods : str or sequence of str
        Names of `one_step_methods()`; the region of one method is also shaded.
    eigenvalues : array_like, shape (n,) or (n, n), optional
        Eigenvalues, or a Jacobian, drawn at step times eigenvalue [1/s].
    step : float, optional
        The step for `eigenvalues`, above 0 [s].
    ax : matplotlib.axes.Axes, optional
        Where to draw; default: a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn in.

    Raises
    ------
    InputError
        If a method is unknown, or eigenvalues come without a step or a step without eigenvalues.
    ImportError
        If matplotlib is missing: ``pip install "substep[plot]"``.

    References
    ----------
    Hairer and Wanner, "Solving Ordinary Differential Equations II", figures IV.2.1 and IV.2.2.

    Examples
    --------
    >>> import substep
    >>> ax = substep.stability.plot(["euler", "rk4"], eigenvalues=[-10.0, 3j], step=0.2)
    >>> ax.get_xlabel()
    'Re $h\\lambda$'
    """
    names = [methods] if isinstance(methods, str) else list(methods)
    if not names:
        raise InputError("methods: expected at least one name")
    regions = [region(name) for name in names]
    if (eigenvalues is None) != (step is None):
        raise InputError("eigenvalues and step: expected both or none")
    points = None
    if eigenvalues is not None:
        points = check_real("step", step, positive=True) * spectrum_of(eigenvalues)
    return _draw(regions, points, ax)


def _draw(regions: list[Region], points: NDArray[np.complex128] | None, ax: Any) -> Any:
    """Outlines of the regions, the first one's inside shaded where it is the only one; points."""
    if ax is None:
        with needs("matplotlib", 'plot needs matplotlib: pip install "substep[plot]"'):
            import matplotlib.pyplot as plt
        ax = plt.subplots(figsize=(6.5, 5.0), layout="constrained")[1]
    ax.axhline(0, color="0.75", linewidth=0.8, zorder=0)
    ax.axvline(0, color="0.75", linewidth=0.8, zorder=0)
    for index, one in enumerate(regions):
        colour = COLOURS[index % len(COLOURS)]
        style = ("-", "--", ":")[index // len(COLOURS) % 3]
        for part, curve in enumerate(one.boundary):
            label = one.method if part == 0 else None
            ax.plot(curve.real, curve.imag, style, color=colour, linewidth=1.6, label=label)
        if len(regions) == 1:
            filled = {"levels": [0, 1], "colors": [colour], "alpha": 0.15}
            ax.contourf(one.real, one.imag, one.modulus, **filled)
    if points is not None:
        label = r"$h\lambda$ of the spectrum"
        ax.plot(points.real, points.imag, "kx", markersize=6, markeredgewidth=1.2, label=label)
    spans = [(min(r.real[0] for r in regions), max(r.real[-1] for r in regions))]
    spans.append((min(r.imag[0] for r in regions), max(r.imag[-1] for r in regions)))
    if points is not None and points.size:
        spans = [
            (min(low, 1.05 * float(values.min())), max(high, 1.05 * float(values.max())))
            for (low, high), values in zip(spans, (points.real, points.imag), strict=True)
        ]
    ax.set(xlim=spans[0], ylim=spans[1], xlabel=r"Re $h\lambda$", ylabel=r"Im $h\lambda$")
    ax.set_aspect("equal")
    ax.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return ax
