"""Surfaces that deform behind the obstacles of another simulation: how they yield, what they get.

Each triangle of a surface is an obstacle and a body of its own, so that the other simulation meets
it as it meets rigid bodies. Its corners, at arms r_i from its middle, have masses m_i. A motion V
= (v, omega) of the triangle gives them velocities G V, G_i = [1, -[r_i]_x]; back, V = D^T v with
D = G (G^T G)^-1 fits any velocities v of the corners, and is exact in those across the triangle.
What pushes the triangle, J = (j, l), is shared out to the corners as D J: their sum is j, their
moment l, and across the triangle that is by the weights of the point of action. So
    W = D^T M^-1 D,   M_i = m_i / (number of triangles at the corner),
is the triangle's mobility: a corner has a part of its mass in each of its triangles, so that all of
them together, pushed at once, yield as the vertices do (Tonge et al., "Mass splitting for
jitter-free parallel rigid body simulation", 2012). What holds the vertices together within the
surface's own solver counts by a trial (bodies.py): in an interval of exchange dt
1. the surface tries the interval with the impulses J' of the last one, and without them, and goes
   back: W becomes what these yield, as a sum, times 3, if that is less;
2. the other simulation advances; each triangle goes straight to where its corners came in the
   trial, with W (J - J') beside that;
3. the surface takes the interval with J, as forces on its vertices.
Without the trials a light and stiff surface would count as so light that what lies on it sinks in:
J' alone stops it, which takes many intervals to grow. But where W is less than half of what the
surface yields to some load, what is much heavier is thrown off: 3 leaves room for loads that move
it more than the present one. Where the surface answers otherwise than W says, its triangles are put
back by the difference. If that is too much of their thickness, the interval is done again in halves
(world.py), as what the other simulation has there might come out on the wrong side.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..errors import InputError, NonFiniteError
from ..geometry.facets import Sheet, SurfaceCollider

if TYPE_CHECKING:
    from ..base.simulation import Simulation

Array = NDArray[np.float64]

_BODIES = 1 << 20  # numbers of bodies that a surface has for itself; below: rigid ones
_SOFTER = 3  # times as much as the present load moves a surface, others may
_LEAST = 1e-6  # part of the mobility of the masses alone that is left
_SMALL = 1e-6  # of half the thickness: what is smaller does not turn


class SurfaceLink:
    """The obstacles of one simulation that stand for triangles of the surface of another.

    Parameters
    ----------
    name, source : str
        Of the simulation that has the obstacles, and of the one whose surface it is.
    members : mapping of str to Simulation
        All there are.
    number : int
        Of the surface, from 0, different in all links.
    places : list of tuple
        Of each obstacle: which of the colliders it is, and its triangle.
    sheet : Sheet
        That the triangles are of.
    """

    def __init__(
        self,
        name: str,
        source: str,
        members: Mapping[str, Any],
        number: int,
        places: list[tuple[int, int]],
        sheet: Sheet,
    ) -> None:
        self.name, self.source, self.number = name, source, number
        self.places, self.sheet = places, sheet
        self._of = members[source]
        self.colliders = [members[name].colliders[k]._native for k, _ in places]
        self._rows = np.array([face for _, face in places])
        self._faces = sheet.faces[self._rows]
        self._shared = np.bincount(self._faces.ravel(), minlength=len(self._of))

    def begin(self, x: Array, v: Array) -> None:
        """An interval begins with vertices at x that move by v."""
        self._corners = self.sheet.corners(x)[self._rows]
        self._D = D = self._share_out(x, self._corners.mean(axis=1))
        inverse = np.where(self._of.pinned, 0.0, self._shared / self._of.masses)
        self._W = np.einsum("kij,ki,kil->kjl", D, np.repeat(inverse[self._faces], 3, axis=1), D)
        many = len(D)
        self._place([-1] * many, v, np.zeros((many, 6)))

    def place(self, v: Array, last: Array, dt: float) -> None:
        """Put them there, to move by v, with the impulses of the last interval."""
        first = (self.number + 1) * _BODIES
        numbers = list(range(first, first + len(last)))
        self._place(numbers, v, -np.einsum("kij,kj->ki", self._W, last) / dt)

    def _place(self, numbers: list[int], v: Array, accelerations: Array) -> None:
        _core.place_facets(
            self.colliders,
            numbers,
            self.number,
            self._corners.reshape(-1, 9),
            self._fit(v),
            self._W.reshape(-1, 36),
            accelerations,
        )

    def _fit(self, v: Array) -> Array:
        """Motions of the triangles, for velocities of the vertices."""
        fitted: Array = np.einsum("kij,ki->kj", self._D, v[self._faces].reshape(-1, 9))
        return fitted

    def stiffen(self, impulses: Array, change: Array) -> None:
        """Count that what holds the vertices together yields less than their masses alone.

        The velocities of the vertices were changed by so much by these impulses, springs and all.
        """
        free = np.einsum("kj,kjl,kl->", impulses, self._W, impulses)
        moved = np.einsum("kj,kj->", impulses, self._fit(change))
        if not moved < free / _SOFTER:
            return
        part, mass = max(_SOFTER * moved / free, _LEAST), self._of.masses
        if not self._of.pinned.any():  # as a whole it yields by the mass of all its vertices
            part = max(part, mass[self._shared > 0].sum() / mass.sum())
        self._W *= part

    def _share_out(self, x: Array, middles: Array) -> Array:
        """D, shape (m, 9, 6)."""
        arms = x[self._faces] - middles[:, None]
        least = _SMALL * self.sheet.radius
        length = np.maximum(np.abs(arms).max(axis=(1, 2), keepdims=True), least)
        r = arms / length  # so that what is inverted has no unit
        blocks = np.zeros((len(r), 3, 3, 6))
        blocks[..., :3] = np.eye(3)
        blocks[:, :, 0, 4], blocks[:, :, 0, 5] = r[..., 2], -r[..., 1]
        blocks[:, :, 1, 3], blocks[:, :, 1, 5] = -r[..., 2], r[..., 0]
        blocks[:, :, 2, 3], blocks[:, :, 2, 4] = r[..., 1], -r[..., 0]
        G = blocks.reshape(-1, 9, 6)
        D: Array = G @ np.linalg.pinv(np.einsum("kij,kil->kjl", G, G))
        D[..., 3:] /= length
        return D

    def off(self) -> float:
        """How far one came from where its corners are now, of half the thickness."""
        corners = self.sheet.corners(np.asarray(self._of.positions, np.float64))[self._rows]
        at = np.array([collider.position for collider in self.colliders])
        return float(np.abs(corners.mean(axis=1) - at).max()) / self.sheet.radius

    def release(self) -> None:
        """Let them move as they are told: alone, a simulation has no surface."""
        _core.release_bodies(self.colliders)

    def impulses(self) -> Array:
        """What the triangles were given since `place` [N s], [N m s], a row for each."""
        given: Array = np.asarray(_core.impulses_of_bodies(self.colliders))
        return given

    def on_vertices(self, impulses: Array) -> Array:
        """The same on all vertices of the surface [N s]."""
        sums = np.zeros((len(self._of), 3))
        given = np.einsum("kij,kj->ki", self._D, impulses).reshape(-1, 3, 3)
        np.add.at(sums, self._faces.ravel(), given.reshape(-1, 3))
        return sums


class Surfaces:
    """All surfaces that are obstacles in a world, and what they were given in the last interval.

    Parameters
    ----------
    members : mapping of str to Simulation
        Of the world.
    given : list of tuple, optional
        What `made()` of another gave, whose members these are copies of.
    """

    def __init__(
        self, members: Mapping[str, Simulation], given: list[tuple[Any, ...]] | None = None
    ) -> None:
        self._members: Mapping[str, Any] = members
        parts = _find(members) if given is None else given
        self.links = [
            SurfaceLink(name, source, members, number, places, sheet)
            for number, (name, source, places, sheet) in enumerate(parts)
        ]
        for link in self.links:
            for k, _ in link.places:
                members[link.name].colliders[k].__dict__["_source"] = members[link.source]
        self.sources = list(dict.fromkeys(link.source for link in self.links))
        self.order = _order(members, self.links)  # in which they advance
        self.pushed = [np.zeros((len(link.places), 6)) for link in self.links]  # [N s], [N m s]
        self._went: dict[str, Array] = {}  # by which vertices get to where the trial had them

    def made(self) -> list[tuple[Any, ...]]:
        """What `Surfaces` of copies of the members are made of."""
        return [(link.name, link.source, link.places, link.sheet) for link in self.links]

    def begin(self, scale: float, dt: float, end: float, name_errors: Callable[..., Any]) -> None:
        """Try where vertices go in an interval, with the impulses of the last one times `scale`.

        name_errors(member, function, *arguments) calls it, and tells whose errors are.
        """
        self.pushed = [scale * impulses for impulses in self.pushed]
        for link in self.links:
            of = self._members[link.source]
            x, v = _motion(of)
            bad = ~np.isfinite(np.hstack([x, v])).all(axis=1)
            if bad.any():
                vertex = int(np.argmax(bad))
                raise NonFiniteError(
                    f"{link.source}: vertex {vertex} is not finite", time=of.time, index=vertex
                )
            link.begin(x, v)
        for name in self.sources:
            of = self._members[name]
            went, v = name_errors(of, self._try, name, dt, end)
            self._went[name] = went
            for k, link in enumerate(self.links):
                if link.source == name and self.pushed[k].any():
                    _, without = name_errors(of, self._try, name, dt, end, k)
                    link.stiffen(self.pushed[k], v - without)

    def _try(self, name: str, dt: float, end: float, without: int = -1) -> tuple[Array, Array]:
        """Mean and last velocities of the vertices in an interval, which is not taken."""
        member = self._members[name]
        before, x = member._kept(), _motion(member)[0]
        obstacles = [collider._native.copy() for collider in member.colliders]
        self._drive(name, dt, end, without, trial=True)
        end_x, v = _motion(member)
        member._put_state(before)
        for collider, kept in zip(member.colliders, obstacles, strict=True):
            collider._native.assign(kept)  # and what they were given in this call
        return (end_x - x) / dt, v

    def advance(self, name: str, dt: float, end: float) -> None:
        """Let a member take the interval, among the surfaces that it meets."""
        met = [k for k, link in enumerate(self.links) if link.name == name]
        for k in met:
            link = self.links[k]
            link.place(self._went[link.source], self.pushed[k], dt)
        if name in self.sources:
            self._drive(name, dt, end)
        else:
            self._members[name]._run(dt, end, None)
        for k in met:
            self.pushed[k] = self.links[k].impulses()

    def _drive(
        self, name: str, dt: float, end: float, without: int = -1, trial: bool = False
    ) -> None:
        """Let it advance with what its vertices were given, spread evenly over its steps."""
        member = self._members[name]
        forces, rows = np.zeros((len(member), 3)), np.arange(len(member))
        for k, (link, given) in enumerate(zip(self.links, self.pushed, strict=True)):
            if link.source == name and k != without:
                forces += link.on_vertices(given) / dt
        sizes = member._even_sizes(dt, end) if member._fixed_step else member._sizes(end)
        for h, is_last in sizes:
            member._write("forces", np.asarray(member._native.forces) + forces, rows)
            member._take_step(h)
            if is_last:
                member._native.time = end
            if not trial:
                member._count(h)

    def off(self) -> float:
        """How far a triangle came from where its corners are now, of half its thickness."""
        return max((link.off() for link in self.links), default=0.0)

    def keep(self) -> list[tuple[Any, ...]]:
        """Copy what members count in a call and no state has, for `put_back`."""
        if not self.links:
            return []
        return [
            (m, copy.copy(m._last), [collider._native.copy() for collider in m.colliders])
            for m in self._members.values()
        ]

    def put_back(self, kept: list[tuple[Any, ...]]) -> None:
        """Go back to that, after the state."""
        for member, last, obstacles in kept:
            member._last = last
            for collider, native in zip(member.colliders, obstacles, strict=True):
                collider._native.assign(native)

    def release(self) -> None:
        """Let all obstacles move as they are told."""
        for link in self.links:
            link.release()

    def state(self) -> dict[str, Array]:
        """Copy the impulses, by names that begin with 'exchanged.'."""
        links = zip(self.links, self.pushed, strict=True)
        return {f"exchanged.{k.name}.{k.source}.{k.number}": given.copy() for k, given in links}


def _motion(member: Any) -> tuple[Array, Array]:
    """Positions and velocities of the vertices."""
    fields = member.fields()
    x, v = (np.array(fields[name][0], np.float64) for name in ("position", "velocity"))
    return x, v


def _find(members: Mapping[str, Simulation]) -> list[tuple[Any, ...]]:
    """Who has obstacles that stand for whose surface, which they are, and the sheet."""
    found: dict[tuple[str, int], tuple[Any, ...]] = {}
    for name, member in members.items():
        for k, collider in enumerate(member.colliders):
            if not isinstance(collider, SurfaceCollider):
                continue
            of = collider.__dict__.get("_source")
            source = next((n for n, m in members.items() if m is of), None)
            if source is None:
                raise InputError(
                    f"members: colliders[{k}] of {name!r} represents a surface of no member; make "
                    "it by make_colliders() of the simulation that is one"
                )
            sheet, thinnest = collider._sheet, member._thinnest
            flat = thinnest is not None and getattr(member, "_dimension", 3) == 2
            if thinnest is None or flat or not member._pushes_bodies:
                how = "in the plane " if flat else "with implicit steps " if thinnest else ""
                raise InputError(
                    f"members: colliders[{k}] of {name!r} represents a surface, which a "
                    f"{type(member).__name__} {how}cannot meet"
                )
            if 2 * sheet.radius < thinnest * (1 - 1e-9):
                raise InputError(
                    f"members: colliders[{k}] of {name!r}: expected a surface of a thickness of at "
                    f"least {thinnest:g} m there, got {2 * sheet.radius:g}"
                )
            parts = found.setdefault((name, id(sheet)), (name, source, [], sheet))
            parts[2].append((k, collider.face))
    return list(found.values())


def _order(members: Mapping[str, Simulation], links: list[SurfaceLink]) -> list[str]:
    """Names such that what meets a surface comes before the simulation whose surface it is.

    There is such an order, as obstacles are made of simulations that are there already.
    """
    order: list[str] = []
    left = list(members)
    while left:
        met = {link.source for link in links if link.name in left}
        order.append(next(name for name in left if name not in met))
        left.remove(order[-1])
    return order
