"""Surfaces filled with tetrahedra: volume, quality, and what is said to be lost."""

from pathlib import Path

import numpy as np
import pytest
from substep import InputError
from substep.geometry import (
    TetMesh,
    TriangleMesh,
    box_mesh,
    grid_mesh,
    read_mesh,
    sphere_mesh,
    tetrahedralize,
)

MESHES = Path(__file__).parents[3] / "shared" / "data" / "meshes"


def check_solid(solid):
    """A valid mesh: positive volumes, good angles, no face of three, a closed surface."""
    assert (solid.volumes > 0).all() and solid.flipped == 0
    angles = np.degrees(solid.dihedral_angles)
    assert angles.min() > 10.7 and angles.max() < 164.8  # Labelle and Shewchuk, theorem 1
    sides = solid.tetrahedra[:, [(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)]].reshape(-1, 3)
    uses = np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)[1]
    assert uses.max() == 2
    surface, _ = solid.surface()
    report = surface.report()
    assert not report.boundary_edges and not report.flipped_edges
    assert surface.volume == pytest.approx(solid.volume)
    assert len(np.unique(solid.tetrahedra)) == len(solid.vertices)


def test_a_sphere_converges_at_second_order():
    mesh = sphere_mesh(1.0, (0.1, 0.2, 0.3), 4)
    errors = []
    for h in (0.28, 0.14, 0.07):
        solid = tetrahedralize(mesh, h)
        check_solid(solid)
        assert solid.lacks == ([] if h < 0.15 else [solid.lacks[0]])
        assert all(phrase.endswith("% of the surface's volume") for phrase in solid.lacks)
        errors.append(1 - solid.volume / mesh.volume)
        on = solid.surface()[0].vertices
        assert np.abs(mesh.signed_distance(on)).max() < 1e-3 * h
    ratio = np.divide(errors[:-1], errors[1:])
    assert (errors[-1] > 0) and ((ratio > 3) & (ratio < 5)).all()


def test_dihedral_angles_of_a_regular_and_a_right_tetrahedron():
    regular = TetMesh([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], [[0, 1, 2, 3]])
    np.testing.assert_allclose(regular.dihedral_angles, np.arccos(1 / 3))
    right = TetMesh(np.eye(4, 3), [[3, 0, 1, 2]])
    angles = np.sort(np.degrees(right.dihedral_angles[0]))
    np.testing.assert_allclose(angles, [np.degrees(np.arccos(3**-0.5))] * 3 + [90] * 3)


@pytest.mark.parametrize("name", ["spot", "cow", "teapot", "suzanne", "stanford-bunny"])
def test_real_meshes(name):
    if not MESHES.is_dir():
        pytest.skip("needs ../shared/data/meshes, which is not here")
    mesh = read_mesh(MESHES / f"{name}.obj")
    solid = tetrahedralize(mesh)
    check_solid(solid)
    report = mesh.report()
    assert [f"surface {phrase}" for phrase in report.lacks] == solid.lacks[: len(report.lacks)]
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    x = np.random.default_rng(4).uniform(low, high, (20000, 3))
    volume = (mesh.signed_distance(x) < 0).mean() * np.prod(high - low)
    assert solid.volume == pytest.approx(volume, rel=0.06)


def test_what_is_lost_is_said():
    box = box_mesh((1, 1, 1))
    spike = TriangleMesh(
        np.concatenate([box.vertices, [[0.0, 0.05, 0.4], [0.05, 0, 0.4], [0, 0, 3]]]),
        np.concatenate([box.faces, [[8, 10, 9], [9, 10, 8]]]),
    )
    lacks = tetrahedralize(spike, 0.2).lacks
    assert any("vertices of the surface lie more than half a spacing off" in w for w in lacks)
    assert any("at most 2.5 m (vertex 10)" in w for w in lacks)
    dumbbell = TriangleMesh(
        np.concatenate([box.vertices, box.vertices + np.array([3, 0, 0])]),
        np.concatenate([box.faces, box.faces + 8]),
    )
    assert tetrahedralize(dumbbell, 0.2).lacks == tetrahedralize(box, 0.2).lacks


def hourglass(waist):
    """A closed surface of revolution, 2 m high, of that diameter in the middle."""
    z = np.linspace(-1, 1, 81)
    r = waist / 2 + 0.4 * np.sin(np.pi * z) ** 2 * np.abs(z) ** 0.3
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rings = np.stack(
        [np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle)), np.outer(z, np.ones(24))], axis=-1
    )
    k, j = np.meshgrid(np.arange(80), np.arange(24), indexing="ij")
    a, b = (24 * k + j).ravel(), (24 * k + (j + 1) % 24).ravel()
    bottom = np.stack([np.arange(1, 25) % 24, np.arange(24), np.full(24, 1944)], axis=1)
    top = np.stack([1920 + np.arange(24), 1920 + np.arange(1, 25) % 24, np.full(24, 1945)], axis=1)
    sides = [np.stack([a, b, b + 24], axis=1), np.stack([a, b + 24, a + 24], axis=1)]
    points = np.concatenate([rings.reshape(-1, 3), [[0, 0, -1], [0, 0, 1]]])
    points[points[:, 0] > 0, 0] *= 1.4  # the lattice is about the middle of the whole
    points[points[:, 1] > 0, 1] *= 1.3
    return TriangleMesh(points, np.concatenate([*sides, bottom, top]))


def test_what_falls_into_pieces_is_filled_more_finely_or_refused():
    mesh = hourglass(0.06)
    assert mesh.report().lacks == []
    with pytest.raises(
        InputError, match=r"0\.2 m the body falls into 2 pieces, .* of 1, .* smaller"
    ):
        tetrahedralize(mesh, 0.2)
    solid = tetrahedralize(mesh)
    check_solid(solid)
    assert solid.volume == pytest.approx(mesh.volume, rel=0.03)
    with pytest.raises(InputError, match="falls into 2 pieces"):
        tetrahedralize(hourglass(0.01))


def test_a_rocker_arm_stays_whole():
    if not MESHES.is_dir():
        pytest.skip("needs ../shared/data/meshes, which is not here")
    mesh = read_mesh(MESHES / "rocker-arm.obj")
    with pytest.raises(InputError, match="falls into 2 pieces"):
        tetrahedralize(mesh, np.ptp(mesh.vertices, axis=0).max() / 10)
    assert tetrahedralize(mesh).volume == pytest.approx(mesh.volume, rel=0.06)


def test_crumbs_are_left_out_and_counted():
    ball, crumb = sphere_mesh(1.0), sphere_mesh(0.09, (1.5, 0, 0), 1)
    both = TriangleMesh(
        np.concatenate([ball.vertices, crumb.vertices]),
        np.concatenate([ball.faces, crumb.faces + len(ball.vertices)]),
    )
    solid = tetrahedralize(both, 0.08)
    assert "1 loose pieces were left out" in solid.lacks
    assert solid.vertices[:, 0].max() < 1.01


def test_what_encloses_nothing_is_refused():
    with pytest.raises(InputError, match=r"lattice lies inside \(open: 40 border"):
        tetrahedralize(grid_mesh(11, 11))
    with pytest.raises(InputError, match="thinner"):
        tetrahedralize(box_mesh((1, 1, 0.001)), 0.37)


@pytest.mark.parametrize("spacing", [0, -1, np.nan, np.inf, 1e-4])
def test_bad_spacing(spacing):
    with pytest.raises(InputError, match="spacing"):
        tetrahedralize(sphere_mesh(), spacing)


def test_same_bits_for_any_number_of_threads():
    mesh = sphere_mesh(subdivisions=2)
    solids = [tetrahedralize(mesh, 0.1, threads=n) for n in (1, 2, 3)]
    assert len({s.vertices.tobytes() + s.tetrahedra.tobytes() for s in solids}) == 1
