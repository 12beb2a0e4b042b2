"""Flows on a grid as meshes of triangles, whose nodes are the middles of cells."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry import Collider
from ..gridfluid import GridFlow, Inflow, Wall
from ..recording import Part, Recording
from ..rigid.colliders import BodyCollider

NORMAL, INFLOW, OUTFLOW, WALL = 0, 4, 5, 6  # types of nodes, as the paper's code numbers them
FIELDS = ("velocity", "pressure", "density")


def read_flow(recording: Recording, part: str, simulation: Any) -> dict[str, NDArray[Any]]:
    """Arrays of the fields of a data set of MeshGraphNets.

    Parameters
    ----------
    recording : Recording
        Open.
    part : str
        The grid.
    simulation : Simulation
        What the scene builds, which knows the sides and the obstacles.

    Returns
    -------
    dict of str to ndarray
        `cells`, `mesh_pos`, `node_type` and those of `FIELDS` that are recorded.

    Raises
    ------
    InputError
        If that is no flow in the plane, the scene builds another one than was recorded, obstacles
        move, or no velocity is recorded.
    """
    shape = recording.parts[part].cells
    flow = _flow_of(recording, part, simulation)
    members = getattr(simulation, "members", {}).values()
    if any(_may_move(collider, members) for collider in flow.colliders):
        raise InputError(f"part: {part} has obstacles that move, for which it has no mesh")
    recorded = [name for name in FIELDS if name in recording.parts[part].fields]
    if "velocity" not in recorded:
        raise InputError(f"part: {part} has no velocity")
    places = flow.positions_of()
    solid = _solid(flow, places.reshape(-1, 2)).reshape(shape)
    triangles = _triangles(solid)
    used, corners = np.unique(triangles, return_inverse=True)
    arrays = {
        "cells": corners.reshape(1, -1, 3).astype(np.int32),
        "mesh_pos": places.reshape(1, -1, 2)[:, used].astype(np.float32),
        "node_type": _types(flow, solid).reshape(1, -1, 1)[:, used].astype(np.int32),
    }
    for name in recorded:
        frames = [recording[part].field(name, k) for k in range(len(recording))]
        values = np.stack(frames).reshape(len(frames), solid.size, -1)
        arrays[name] = values[:, used].astype(np.float32)
    return arrays


def _flow_of(recording: Recording, part: str, simulation: Any) -> GridFlow:
    """The member of a world of that name; else the one flow that has the cells of the part."""
    members = getattr(simulation, "members", {"": simulation})
    one = recording.parts[part]
    given = [members[part]] if part in members else list(members.values())
    flows = [m for m in given if isinstance(m, GridFlow)]
    if not flows or len(one.cells) != 2:
        raise InputError(f"part: expected a GridFlow in the plane, but {part} is of something else")
    same = [flow for flow in flows if flow.shape == one.cells and _lies_in(flow, one)]
    if not same:
        raise InputError(
            f"part: {part} was recorded in cells that the scene no longer builds; it has changed "
            "since the run"
        )
    if len(same) > 1:
        raise InputError(f"part: {part} may be of {len(same)} flows; give it the name of one")
    return same[0]


def _lies_in(flow: GridFlow, part: Part) -> bool:
    """Whether the cells are in the box of the part."""
    off = np.abs(np.asarray(part.bounds, float) - flow.bounds)
    return bool((off < 1e-6 * flow.cell).all())


def _may_move(collider: Collider, members: Any) -> bool:
    """Whether it moves, or stands for a body of the world that is not static."""
    if collider.velocity.any() or collider.angular_velocity.any():
        return True
    bodies: Any = collider.__dict__.get("_bodies")
    if not isinstance(collider, BodyCollider) or not any(bodies is m for m in members):
        return False
    return bool((bodies.motions[bodies.ids == collider.body] != "static").any())


def _solid(flow: GridFlow, x: NDArray[Any]) -> NDArray[np.bool_]:
    """Which points are in an obstacle."""
    space = np.pad(x, ((0, 0), (0, 1)))
    inside = [collider.distance(space) < 0 for collider in flow.colliders]
    return np.any([np.zeros(len(x), bool), *inside], axis=0)


def _triangles(solid: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Two between each four middles of cells, but for those with a corner in an obstacle."""
    node = np.arange(solid.size).reshape(solid.shape)
    a, b, c, d = node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:]
    both = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    kept: NDArray[np.int64] = both[~solid.ravel()[both].any(axis=1)]
    return kept


def _types(flow: GridFlow, solid: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Of each cell; where two sides meet, walls count before inflows, and these before outflows."""
    kinds = np.full(solid.shape, NORMAL)
    for kind in (OUTFLOW, INFLOW, WALL):
        for a, pair in enumerate(flow.sides):
            for end, side in zip((0, -1), pair, strict=True):
                if _kind(side) == kind:
                    np.moveaxis(kinds, a, 0)[end] = kind
    about = np.pad(solid, 1)
    n, m = solid.shape
    beside = [about[i : i + n, j : j + m] for i in range(3) for j in range(3)]
    kinds[np.any(beside, axis=0)] = WALL
    return kinds


def _kind(side: Any) -> int:
    if isinstance(side, Inflow):
        return INFLOW
    return WALL if isinstance(side, Wall) else {"wall": WALL, "open": OUTFLOW}.get(side, NORMAL)
