"""Elastic solids of tetrahedra."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import (
    as_array,
    check_array,
    check_choice,
    check_positive,
    check_real,
    check_sequence,
    in_range,
)
from ..errors import InputError
from ..geometry import Collider, Shape, TetMesh, TriangleMesh, read_mesh, tetrahedralize
from ..geometry.topology import check_vertices
from .deformable import Array, Deformable

_FLAT = 1e-12  # of the cube of the longest edge: a volume that rounding alone can make


class SoftBody(Deformable):
    """An elastic solid of linear tetrahedra.

    Parameters
    ----------
    positions : array_like, shape (n, 3)
        Initial positions [m]; copied.
    tetrahedra : array_like of int, shape (m, 4)
        Vertices of the tetrahedra. Those whose volume at rest is negative have two vertices
        swapped; `mesh.flipped` counts them.
    density : float or array_like, shape (m,)
        Mass per volume at rest [kg/m^3], above 0. A vertex has a quarter of the mass of its
        tetrahedra.
    young_modulus : float or array_like, shape (m,)
        E [Pa], above 0.
    poisson_ratio : float or array_like, shape (m,)
        nu, above -1 and below 0.5.
    model : {'neo_hookean', 'st_venant_kirchhoff'}
        The elastic energy; both are Hooke's law at small strains. The first returns from inversion
        and resists compression, the second does neither (docs/soft_body.md).
    damping_time : float
        Damping time tau [s], at least 0: the viscous stress is that of tau times the strain
        rate, and a mode of angular frequency omega has the damping ratio tau omega / 2.
    rest_positions : array_like, shape (n, 3), optional
        Where nothing is strained [m]; the initial positions unless given.
    velocities, pinned, drag, gravity, colliders, integrator, step, solver, tolerance,
    max_iterations, on_fail, contact_margin, contact_stiffness, sticking_speed, time, threads
        As for `MassSpring`; the solver is 'newton'.

    Attributes
    ----------
    mesh : TetMesh
        The solid at rest.
    faces : ndarray of int64, shape (k, 3)
        Triangles of its surface, looking outward; vertex numbers of the body.

    Raises
    ------
    InputError
        If an argument is wrong, with its name and the first bad index; if a tetrahedron has no
        volume.

    References
    ----------
    Smith, de Goes and Kim, "Stable neo-Hookean flesh simulation", ACM Trans. Graph. 37 (2018) 12,
    eq. 14; the same, "Analytic eigensystems for isotropic distortion energies", ACM Trans. Graph.
    38 (2019) 3; Sifakis and Barbic, "FEM simulation of 3D deformable solids", SIGGRAPH 2012.

    Examples
    --------
    A jelly that hangs from its top is longest at the end.

    >>> import substep
    >>> cube = substep.geometry.box_tetrahedra((0.1, 0.1, 0.1), (3, 3, 3))
    >>> jelly = substep.SoftBody(
    ...     cube.vertices, cube.tetrahedra, density=1000, young_modulus=2e4, poisson_ratio=0.3,
    ...     damping_time=0.02, pinned=cube.vertices[:, 2] > 0.04)
    >>> jelly.advance(0.5)
    >>> bool(-0.055 < jelly.positions[:, 2].min() < -0.051)
    True
    """

    mesh: TetMesh
    faces: NDArray[np.int64]
    model: str
    density: Array
    young_modulus: Array
    poisson_ratio: Array
    damping_time: float

    def __init__(
        self,
        positions: ArrayLike,
        tetrahedra: ArrayLike,
        *,
        density: ArrayLike,
        young_modulus: ArrayLike,
        poisson_ratio: ArrayLike,
        model: str = "neo_hookean",
        damping_time: float = 0.0,
        rest_positions: ArrayLike | None = None,
        velocities: ArrayLike | None = None,
        pinned: ArrayLike = (),
        drag: float = 0.0,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        colliders: Sequence[Collider | Shape] = (),
        integrator: str = "implicit_euler",
        step: float | None = None,
        solver: str = "newton",
        tolerance: float | None = None,
        max_iterations: int | None = None,
        on_fail: str = "substep",
        contact_margin: float = 1e-3,
        contact_stiffness: float | None = None,
        sticking_speed: float = 1e-3,
        time: float = 0.0,
        threads: int | None = None,
    ) -> None:
        x = check_vertices("positions", positions)
        rest = x if rest_positions is None else check_vertices("rest_positions", rest_positions)
        if rest.shape != x.shape:
            raise InputError(f"rest_positions: expected shape {x.shape}, got {rest.shape}")
        self.mesh = TetMesh(rest, tetrahedra)
        self.faces = self.mesh.surface_faces
        _refuse_flat(self.mesh)
        m = len(self.mesh.tetrahedra)
        self.model = check_choice("model", model, _core.elastic_models)
        self.density = check_positive("density", density, m)
        self.young_modulus = check_positive("young_modulus", young_modulus, m)
        self.poisson_ratio = _check_poisson_ratio(poisson_ratio, m)
        self.damping_time = check_real("damping_time", damping_time, nonnegative=True)
        for constant in (self.density, self.young_modulus, self.poisson_ratio):
            constant.flags.writeable = False
        if str(solver).lower() == "projective":
            raise InputError("solver: 'projective' is for springs; a soft body takes 'newton'")
        with in_range("density"):
            quarters = np.repeat(self.density * self.mesh.volumes / 4, 4)
        masses: Array = np.bincount(self.mesh.tetrahedra.ravel(), quarters, len(x)).astype(float)
        if (masses == 0).any():
            index = int(np.argmin(masses))
            raise InputError(
                f"positions[{index}]: no tetrahedron has this vertex, so it has no mass"
            )
        self._set_up(
            x,
            masses,
            velocities=velocities,
            pinned=pinned,
            drag=drag,
            gravity=gravity,
            colliders=colliders,
            integrator=integrator,
            step=step,
            solver=solver,
            tolerance=tolerance,
            max_iterations=max_iterations,
            on_fail=on_fail,
            contact_margin=contact_margin,
            contact_stiffness=contact_stiffness,
            sticking_speed=sticking_speed,
            time=time,
            threads=threads,
        )

    def _terms(self) -> list[Any]:
        terms: list[Any] = _core.tetrahedra_terms(
            self.mesh.vertices,
            self.mesh.tetrahedra.astype(np.int32),
            self.young_modulus,
            self.poisson_ratio,
            self.model,
            self.damping_time,
        )
        return terms

    @classmethod
    def from_mesh(
        cls,
        mesh: TetMesh | TriangleMesh | str | os.PathLike[str] | Sequence[ArrayLike],
        *,
        spacing: float | None = None,
        density: ArrayLike,
        young_modulus: ArrayLike,
        poisson_ratio: ArrayLike,
        model: str = "neo_hookean",
        damping_time: float = 0.0,
        velocities: ArrayLike | None = None,
        pinned: ArrayLike = (),
        drag: float = 0.0,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        colliders: Sequence[Collider | Shape] = (),
        integrator: str = "implicit_euler",
        step: float | None = None,
        solver: str = "newton",
        tolerance: float | None = None,
        max_iterations: int | None = None,
        on_fail: str = "substep",
        contact_margin: float = 1e-3,
        contact_stiffness: float | None = None,
        sticking_speed: float = 1e-3,
        time: float = 0.0,
        threads: int | None = None,
    ) -> SoftBody:
        """Make a solid of a mesh of tetrahedra, or fill a surface.

        Parameters
        ----------
        mesh : TetMesh, TriangleMesh, path-like or (vertices, faces)
            The solid or its surface, or a file that holds one (`geometry.read_mesh`).
        spacing : float, optional
            For surfaces: the size of the tetrahedra that fill them [m]; by default 1/20 of the
            longest side (`geometry.tetrahedralize`).
        density, young_modulus, poisson_ratio, model, damping_time, velocities, pinned, drag,
        gravity, colliders, integrator, step, solver, tolerance,
        max_iterations, on_fail, contact_margin, contact_stiffness, sticking_speed, time, threads
            As for `SoftBody`.

        Returns
        -------
        SoftBody
            The solid; its `mesh.lacks` lists the defects of the surface.

        Raises
        ------
        InputError
            If an argument is wrong, or the surface has no inside.
        FormatError, OSError
            If a file cannot be read.

        Examples
        --------
        >>> import substep
        >>> ball = substep.SoftBody.from_mesh(
        ...     substep.geometry.sphere_mesh(0.1), spacing=0.05,
        ...     density=1000, young_modulus=1e4, poisson_ratio=0.4)
        >>> bool(3.8 < ball.masses.sum() < 4.3)
        True
        """
        if isinstance(mesh, (str, os.PathLike)):
            mesh = read_mesh(mesh)
        elif not isinstance(mesh, (TetMesh, TriangleMesh)):
            pair = check_sequence("mesh", mesh, "vertices and of faces")
            if len(pair) != 2:
                raise InputError("mesh: expected a mesh, a path or a pair (vertices, faces)")
            mesh = TriangleMesh(*pair)
        solid = tetrahedralize(mesh, spacing) if isinstance(mesh, TriangleMesh) else mesh
        used, corners = np.unique(solid.tetrahedra, return_inverse=True)
        body = cls(
            solid.vertices[used],
            corners.reshape(-1, 4),
            density=density,
            young_modulus=young_modulus,
            poisson_ratio=poisson_ratio,
            model=model,
            damping_time=damping_time,
            velocities=velocities,
            pinned=pinned,
            drag=drag,
            gravity=gravity,
            colliders=colliders,
            integrator=integrator,
            step=step,
            solver=solver,
            tolerance=tolerance,
            max_iterations=max_iterations,
            on_fail=on_fail,
            contact_margin=contact_margin,
            contact_stiffness=contact_stiffness,
            sticking_speed=sticking_speed,
            time=time,
            threads=threads,
        )
        body.mesh.lacks.extend(solid.lacks)
        return body


def _refuse_flat(mesh: TetMesh) -> None:
    corners = mesh.vertices[mesh.tetrahedra]
    edges = corners[:, [1, 2, 3, 2, 3, 3]] - corners[:, [0, 0, 0, 1, 1, 2]]
    longest = np.sqrt((edges**2).sum(axis=2).max(axis=1))
    flat = ~(mesh.volumes > _FLAT * longest**3)
    if flat.any():
        row = int(np.argmax(flat))
        raise InputError(
            f"tetrahedra[{row}]: flat, its volume is {mesh.volumes[row]:.3g} m^3 and its longest "
            f"edge {longest[row]:.3g} m"
        )


def _check_poisson_ratio(value: ArrayLike, count: int) -> Array:
    given = as_array("poisson_ratio", value)
    rows = given if given.ndim else np.repeat(given, count)
    ratio: Array = check_array("poisson_ratio", rows, (count,))
    bad = (ratio <= -1) | (ratio >= 0.5)
    if bad.any():
        index = int(np.argmax(bad))
        raise InputError(
            f"poisson_ratio[{index}]: expected a number above -1 and below 0.5 "
            f"(incompressible solids need 0.49 or a mixed method), got {ratio[index]}"
        )
    return ratio
