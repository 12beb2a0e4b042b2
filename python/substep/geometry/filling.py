"""Filling a surface with tetrahedra."""

from __future__ import annotations

import math

import numpy as np

from ..base.checks import check_real, check_threads, in_range
from ..errors import InputError
from .tet_mesh import TetMesh
from .topology import Array, Indices, components
from .triangle_mesh import TriangleMesh, check_mesh

_CRUMB = 1e-2  # of the largest piece's volume: smaller ones are left out
_FINER = 5  # spacings that are tried where none is given, each 1 / sqrt(2) of the one before


def tetrahedralize(
    mesh: TriangleMesh, spacing: float | None = None, *, threads: int | None = None
) -> TetMesh:
    """Fill a surface with tetrahedra, whatever it lacks.

    A body-centred cubic lattice is cut at the surface (isosurface stuffing): the tetrahedra have
    one size and dihedral angles between 10 and 165 degrees. Inside is where the winding number is
    above 1/2, so the surface may be open, not manifold or cut itself. The vertices of a closed
    mesh's new surface lie on the old one, within 1e-4 spacing; edges are rounded, and parts thinner
    than the spacing get lost, at the size of the lattice. `TetMesh.lacks` says what was lost. A
    body that falls into pieces by that is refused.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface.
    spacing : float, optional
        Edge of the lattice's cubes [m], the longest edge inside; by default 1/20 of the longest
        side of the mesh's bounding box, or down to 1/80 where the body would fall into pieces.
    threads : int, optional
        Threads to use; the result does not depend on them.

    Returns
    -------
    TetMesh
        The solid, without loose pieces of less than 1 % of the largest one's volume.

    Raises
    ------
    InputError
        If no lattice point lies inside, the body falls into more pieces than the surface has, or
        the lattice would have more than 2e7 points.

    References
    ----------
    Labelle and Shewchuk (2007), "Isosurface stuffing: fast tetrahedral meshes with good dihedral
    angles", ACM Trans. Graph. 26, 57.

    Examples
    --------
    >>> import substep
    >>> ball = substep.geometry.tetrahedralize(substep.geometry.sphere_mesh(), spacing=0.25)
    >>> ball.lacks
    ["98.5 % of the surface's volume"]
    """
    corners = check_mesh(mesh).vertices[mesh.faces]
    sides = corners.max((0, 1)) - corners.min((0, 1))
    coarsest = check_real(
        "spacing", sides.max() / 20 if spacing is None else spacing, positive=True
    )
    report = mesh.report()
    for k in range(1 if spacing is not None else _FINER):
        h = coarsest / math.sqrt(2) ** k
        with in_range("spacing"):
            points = 2 * np.prod(sides / h + 4)
        if not points <= 2e7:
            raise InputError(f"spacing: {h} gives a lattice of {points:.1e} points, more than 2e7")
        vertices, cells = mesh._tree.stuff(h, check_threads(threads))
        if len(cells) == 0:
            lacks = "; ".join(report.lacks) or "parts thinner than the spacing"
            raise InputError(
                f"mesh: no point of the lattice lies inside ({lacks}); spacing is {h}, and what is "
                "flat has no inside (a cloth needs no filling)"
            )
        vertices, cells, crumbs = _without_crumbs(vertices, cells)
        solid = TetMesh(vertices, cells)
        pieces = int(components(len(vertices), solid.edges).max()) + 1
        if pieces <= report.components:
            break
    else:
        raise InputError(
            f"spacing: at {h:.3g} m the body falls into {pieces} pieces, of a surface of "
            f"{report.components}, because thinner parts get lost; take a smaller spacing"
        )
    solid.lacks.extend(f"surface {phrase}" for phrase in report.lacks)
    if crumbs:
        solid.lacks.append(f"{crumbs} loose pieces were left out")
    if report.closed and abs(solid.volume / abs(report.volume) - 1) > 0.01:
        share = 100 * solid.volume / abs(report.volume)
        solid.lacks.append(f"{share:.1f} % of the surface's volume")
    used = np.unique(mesh.faces)
    away = solid.surface()[0].nearest(mesh.vertices[used], threads)[0]
    if away.max() > 0.5 * h:
        worst = int(used[np.argmax(away)])
        solid.lacks.append(
            f"{(away > 0.5 * h).sum()} vertices of the surface lie more than half a spacing off, "
            f"at most {away.max():.3g} m (vertex {worst})"
        )
    return solid


def _without_crumbs(vertices: Array, cells: Indices) -> tuple[Array, Indices, int]:
    """Leave out pieces that are tiny beside the largest one; their number comes last."""
    everything = TetMesh(vertices, cells)
    label = components(len(vertices), everything.edges)[everything.tetrahedra[:, 0]]
    volume = np.bincount(label, everything.volumes)
    kept = (volume >= _CRUMB * volume.max())[label]
    used, renumbered = np.unique(everything.tetrahedra[kept], return_inverse=True)
    crumbs = int((volume > 0).sum() - len(np.unique(label[kept])))
    return vertices[used], renumbered.reshape(-1, 4), crumbs
