"""Collisions of particles with each other, and of a surface with itself."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import _core
from ..base.checks import as_array, check_real
from ..errors import InputError
from .group import Array, Constraint, check_each, check_particles


class _Contacts(Constraint):
    """Constraints that come and go: of no certain particles."""

    def __init__(self, friction: float) -> None:
        self.particles = np.zeros((0, 2), np.int32)
        self.compliance = self.damping = np.zeros(1)
        self.stiffness = None
        self.friction = check_real("friction", friction, nonnegative=True)


class ParticleCollision(_Contacts):
    """Particles as balls that do not overlap: C = |x_0 - x_1| - (r_0 + r_1) >= 0.

    Particles that are closer than that at the start keep their distance instead, so that a rope of
    overlapping particles exerts nothing on itself. A particle that moves by more than its radius in
    a substep may pass another one: take more substeps. Give it as the last of the constraints.

    Parameters
    ----------
    radii : float or array_like, shape (n,)
        Of all particles of the simulation, or of each [m], at least 0; 0 collides with nothing.
    friction : float
        Coulomb's coefficient, at least 0.

    Raises
    ------
    InputError
        If an argument is wrong, with its name.

    References
    ----------
    Mueller et al., "Position based dynamics", 2007, eq. 10 and 11; Macklin et al., "Unified
    particle physics for real-time applications", 2014, section 6.1.

    Examples
    --------
    A ball meets one of the same mass, without restitution.

    >>> import substep
    >>> sim = substep.PositionBasedDynamics(
    ...     [[0, 0, 0], [1, 0, 0]],
    ...     1.0,
    ...     [substep.pbd.ParticleCollision(radii=0.1)],
    ...     velocities=[[1, 0, 0], [0, 0, 0]],
    ...     gravity=[0, 0, 0],
    ... )
    >>> sim.advance(1.0)
    >>> sim.velocities[:, 0].round(3)
    array([0.5, 0.5])
    """

    def __init__(self, radii: ArrayLike, *, friction: float = 0.0) -> None:
        super().__init__(friction)
        self.radii = check_each("radii", radii, as_array("radii", radii).size)

    def _groups(self, positions: Array) -> list[Any]:
        n = len(positions)
        if len(self.radii) not in (1, n):
            raise InputError(f"radii: expected one number or {n}, got {len(self.radii)}")
        radii = np.ascontiguousarray(np.broadcast_to(self.radii, (n,)))
        make = _core.particle_collision
        return [make(radii, np.ascontiguousarray(positions), self.friction)]


class SelfCollision(_Contacts):
    """A surface of triangles that keeps a thickness from itself and never passes through itself.

    Vertices and triangles, and edges and edges, keep the thickness or their distance at the start
    where that is less: a flat sheet exerts nothing on itself, nor does one that lies folded. What
    the other constraints and the obstacles want beyond that is cut back at the end of each substep,
    so that none passes through, except where pinned particles leave no way out. To that end no
    vertex moves by more than the mean edge from the mean motion of the surface in a substep. Give
    it as the last of the constraints.

    Parameters
    ----------
    faces : array_like of int, shape (m, 3)
        Triangles of particles. Several pieces of cloth may be one surface.
    thickness : float
        Distance that is kept [m], above 0; a third of an edge serves well.
    friction : float
        Coulomb's coefficient, at least 0.

    Raises
    ------
    InputError
        If an argument is wrong, with its name.

    References
    ----------
    Mueller et al., "Position based dynamics", 2007, section 4.3; Macklin et al., "Unified particle
    physics for real-time applications", 2014, section 6.1; Harmon et al., "Robust treatment of
    simultaneous collisions", 2008.

    Examples
    --------
    >>> import substep
    >>> mesh = substep.geometry.grid_mesh(10, 10)
    >>> cloth = substep.pbd.SelfCollision(mesh.faces, thickness=0.03, friction=0.3)
    >>> cloth.thickness
    0.03
    """

    def __init__(self, faces: ArrayLike, *, thickness: float, friction: float = 0.0) -> None:
        super().__init__(friction)
        self.faces = check_particles("faces", faces, 3)
        self.thickness = check_real("thickness", thickness, positive=True)

    def _groups(self, positions: Array) -> list[Any]:
        wrong = (self.faces < 0) | (self.faces >= len(positions))
        if wrong.any():
            k = int(np.argmax(wrong.any(axis=1)))
            raise InputError(
                f"faces[{k}]: expected indices from 0 to {len(positions) - 1}, "
                f"got {self.faces[k].tolist()}"
            )
        make = _core.self_collision
        return [make(self.faces, np.ascontiguousarray(positions), self.thickness, self.friction)]
