"""Meshes: topology, measures, reports, reading, primitives, bad input."""

import copy
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import substep
from substep import FormatError, InputError
from substep.geometry import (
    TetMesh,
    TriangleMesh,
    box_mesh,
    box_tetrahedra,
    grid_mesh,
    mesh_io,
    read_mesh,
    sphere_mesh,
)

MESHES = Path(__file__).parents[3] / "shared" / "data" / "meshes"


def real_mesh(name):
    if not MESHES.is_dir():
        pytest.skip("needs ../shared/data/meshes, which is not here")
    return read_mesh(MESHES / name)


def brute_edges(faces):
    found = {}
    for face in faces.tolist():
        for k in range(3):
            found.setdefault(tuple(sorted((face[k], face[k - 1]))), []).append(face)
    return found


CLOSED = {
    "sphere": lambda: sphere_mesh(2.0, (1, 2, 3), 2),
    "box": lambda: box_mesh((1, 2, 3)),
    "beam": lambda: box_tetrahedra((1, 2, 3), (2, 3, 4)).surface()[0],
}


@pytest.mark.parametrize("name", CLOSED)
def test_closed_meshes_are_reported_as_such(name):
    report = CLOSED[name]().report()
    assert report.closed and report.lacks == []
    assert str(report).endswith("closed, manifold, oriented")
    mesh = CLOSED[name]()
    assert len(mesh.vertices) - len(mesh.edges) + len(mesh.faces) == 2  # Euler
    assert mesh.boundary_loops == []


def test_edges_and_hinges_against_a_dictionary():
    mesh = real_mesh("suzanne.obj")  # open, with an edge of three faces
    found = brute_edges(mesh.faces)
    assert sorted(found) == list(map(tuple, mesh.edges.tolist()))
    assert [len(found[e]) for e in sorted(found)] == mesh.edge_uses.tolist()
    assert len(mesh.hinges) == sum(len(faces) - 1 for faces in found.values())
    for a, b, c, d in mesh.hinges.tolist():
        corners = [set(face) for face in found[a, b]]
        assert {a, b, c} in corners and {a, b, d} in corners
        assert a < b


def test_hinges_of_an_oriented_mesh_keep_the_orientation():
    mesh = sphere_mesh(subdivisions=1)
    a, b, c, d = mesh.hinges.T
    x = mesh.vertices
    for one in (np.cross(x[b] - x[a], x[c] - x[a]), np.cross(x[a] - x[b], x[d] - x[b])):
        assert (np.einsum("ij,ij->i", one, x[a]) > 0).all()  # both look outward


def test_measures_of_a_sphere_converge_at_second_order():
    def errors(s):
        mesh = sphere_mesh(1.0, (5, 0, 0), s)
        return [abs(mesh.area / (4 * np.pi) - 1), abs(mesh.volume / (4 / 3 * np.pi) - 1)]

    ratio = np.divide(errors(3), errors(4))
    np.testing.assert_allclose(ratio, 4, rtol=0.02)


def test_vertex_areas_and_volumes_sum_to_the_whole():
    mesh = grid_mesh(5, 4, (2, 3))
    assert mesh.vertex_areas.sum() == pytest.approx(6)
    np.testing.assert_array_equal(mesh.face_normals, np.tile([0, 0, 1], (24, 1)))
    beam = box_tetrahedra((1, 2, 3), (2, 2, 2))
    assert beam.vertex_volumes.sum() == pytest.approx(6)
    assert (beam.volumes > 0).all() and beam.flipped == 0


def test_grid_lies_as_documented():
    mesh = grid_mesh(3, 4, (2, 3))
    assert mesh.vertices[1 * 4 + 3].tolist() == [0, 1.5, 0]
    (loop,) = mesh.boundary_loops
    assert len(loop) == 2 * (2 + 3)
    turns = np.cross(mesh.vertices[loop], np.roll(mesh.vertices[loop], -1, axis=0))
    assert turns[:, 2].sum() / 2 == pytest.approx(6)  # runs round counter-clockwise


def test_tetrahedra_are_turned_and_their_surface_looks_outward():
    beam = box_tetrahedra((1, 1, 1), (2, 2, 2))
    tets = beam.tetrahedra.copy()
    tets[::3] = tets[::3][:, [0, 1, 3, 2]]
    turned = TetMesh(beam.vertices, tets)
    assert turned.flipped == 16
    np.testing.assert_array_equal(turned.tetrahedra, beam.tetrahedra)
    surface, used = beam.surface()
    assert surface.volume == pytest.approx(1)
    np.testing.assert_array_equal(surface.vertices, beam.vertices[used])
    assert len(beam.edges) == len(brute_edges_of_tets(beam.tetrahedra))


def brute_edges_of_tets(tets):
    return {tuple(sorted((t[i], t[j]))) for t in tets.tolist() for i in range(4) for j in range(i)}


def defect(faces, vertices=None):
    base = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1], [0, 0, 0]]
    return TriangleMesh(vertices or base, faces).report()


def test_each_defect_is_named():
    tetrahedron = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    closed = defect(tetrahedron)
    assert closed.closed and closed.volume == pytest.approx(1 / 6)
    assert "2 unused vertices" in closed.lacks and "1 duplicated vertices" in closed.lacks
    assert "inside out" in defect([f[::-1] for f in tetrahedron]).lacks
    assert any(w.startswith("open: 3 border edges, 1 holes") for w in defect(tetrahedron[1:]).lacks)
    flipped = defect([tetrahedron[0][::-1], *tetrahedron[1:]])
    assert flipped.flipped_edges == 3 and not flipped.closed
    fan = defect([[0, 1, 2], [0, 1, 3], [1, 0, 4], [0, 1, 5], [0, 1, 2]])
    assert fan.non_manifold_edges == 1 and fan.duplicate_faces == 1 and fan.flat_faces == 1
    assert "1 edges with more than two faces" in fan.lacks
    two = defect([[0, 1, 2], [3, 4, 5]])
    assert two.components == 2


def test_edges_through_faces_are_counted():
    one, two = box_mesh((1, 1, 1)), box_mesh((1, 1, 1))

    def moved(offset):
        vertices = np.concatenate([one.vertices, two.vertices + np.array(offset)])
        return TriangleMesh(vertices, np.concatenate([one.faces, two.faces + 8])).report()

    # A corner of each inside the other: three edges of each and two or three diagonals pass.
    cut = moved([0.61, 0.52, 0.43])
    assert cut.pierced == brute_pierced([0.61, 0.52, 0.43]) > 6
    assert f"cuts itself: {cut.pierced} edges pass through a face" in cut.lacks
    assert moved([1.5, 0, 0]).pierced == 0
    assert moved([1.0, 0.2, 0.3]).pierced == 0  # they only touch
    assert moved([0, 0, 0]).pierced == 0
    assert moved([0, 0, 0]).duplicate_vertices == 8


def brute_pierced(offset):
    """An edge of an axis-parallel box passes through a face of the other where it changes sides."""
    count = 0
    box = box_mesh((1, 1, 1))
    for shift in (np.array(offset), -np.array(offset)):
        for p, q in (box.vertices + shift)[box.edges]:
            crossed = False
            for axis in range(3):
                for wall in (-0.5, 0.5):
                    if (p[axis] - wall) * (q[axis] - wall) < 0:
                        t = (wall - p[axis]) / (q[axis] - p[axis])
                        crossed |= bool((np.abs(np.delete(p + t * (q - p), axis)) < 0.5).all())
            count += crossed
    return count


def test_embedded_points_follow_an_affine_motion():
    beam = box_tetrahedra((2, 1, 1), (5, 3, 2))
    x = np.random.default_rng(2).uniform(-1, 1, (500, 3)) * [1.2, 0.6, 0.6]
    cells, weights = beam.embed(x)
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    inside = (np.abs(x) <= [1, 0.5, 0.5]).all(axis=1)
    assert (weights[inside] > -1e-12).all() and (weights[~inside].min(axis=1) < 0).all()
    turn = np.array([[0, -1, 0.3], [1, 0.2, 0], [0, 0, 2]])
    moved = beam.vertices @ turn.T + [1, 2, 3]
    follow = (weights[..., None] * moved[cells]).sum(axis=1)
    np.testing.assert_allclose(follow, x @ turn.T + [1, 2, 3], atol=1e-13)
    assert beam.embed(np.empty((0, 3)))[0].shape == (0, 4)


def test_cleaning_joins_and_drops():
    soup = sphere_mesh(subdivisions=1)
    corners = soup.vertices[soup.faces].reshape(-1, 3)
    mesh = TriangleMesh(corners, np.arange(len(corners)).reshape(-1, 3))
    assert not mesh.report().closed
    cleaned = mesh.cleaned()
    assert cleaned.report().closed and len(cleaned.vertices) == len(soup.vertices)
    flat = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0]], [[0, 1, 2], [0, 1, 3]])
    assert flat.cleaned().report().dropped_faces == 1
    with pytest.raises(InputError, match="every face"):
        TriangleMesh(np.zeros((3, 3)), [[0, 1, 2]]).cleaned()


@pytest.mark.parametrize(
    "name, vertices, faces, lacks",
    [
        ("spot.obj", 2930, 5856, []),
        ("cow.obj", 2903, 5804, ["cuts itself: 72 edges pass through a face"]),
        ("stanford-bunny.obj", 35947, 69451, ["open: 223 border edges, 5 holes"]),
        ("teapot.obj", 3644, 6320, ["open: 1036 border edges", "403 duplicated vertices"]),
        ("suzanne.obj", 507, 968, ["open: 42 border edges", "1 edges with more than two faces"]),
    ],
)
def test_real_meshes(name, vertices, faces, lacks):
    mesh = real_mesh(name)
    assert (len(mesh.vertices), len(mesh.faces)) == (vertices, faces)
    said = str(mesh.report())
    for phrase in lacks:
        assert phrase in said
    assert mesh.report().closed == ("open" not in said)


def write(path, text):
    path.write_text(text)
    return path


def test_obj_negative_numbers_polygons_and_comments(tmp_path):
    text = (
        "# x\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0 0.5\nvt 0 0\nvn 0 0 1\nf -4//1 -3//1 -2//1 -1//1\n"
    )
    mesh = read_mesh(write(tmp_path / "a.OBJ", text + "f 1 2 2\nf 1 2 3\nusemtl x\n"))
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]
    assert mesh.dropped == 1 and "1 faces were left out" in mesh.report().lacks


@pytest.mark.parametrize(
    "text, said",
    [
        ("v 0 0\n", ":1: cannot read 'v 0 0'"),
        ("v 0 0 0\nf 1 2 x\n", ":2: cannot read"),
        ("v 0 0 0\nf 1 2\n", ":2: cannot read"),
        ("v 0 0 0\nf 1 2 0\n", ":2: cannot read"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "a face names vertex 4, and there are 3"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n", "a face names vertex 0, and there are 3"),
        ("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", r"vertices\[1, 0\]"),
        ("v 0 0 0\n", "no triangles"),
        ("", "no triangles"),
        ("\0\1\2", "no triangles"),
    ],
)
def test_broken_obj(tmp_path, text, said):
    with pytest.raises(FormatError, match=said):
        read_mesh(write(tmp_path / "bad.obj", text))


@pytest.mark.parametrize(
    ("suffix", "options"),
    [("off", {}), ("vtk", {}), ("vtu", {}), ("msh", {}), ("ply", {"binary": False}), ("stl", {})],
)
def test_formats_that_meshio_writes(tmp_path, suffix, options):
    meshio = pytest.importorskip("meshio")
    mesh = sphere_mesh(subdivisions=1)
    path = tmp_path / f"ball.{suffix}"
    cells = [("triangle", mesh.faces.astype(np.int32))]
    meshio.Mesh(mesh.vertices, cells).write(path, **options)
    again = read_mesh(path)
    assert again.report().closed
    assert again.volume == pytest.approx(mesh.volume, rel=1e-5)
    assert len(again.vertices) == len(mesh.vertices)


def test_what_meshio_takes_is_limited(tmp_path, monkeypatch):
    """A reader of meshio that goes round for ever, and one that allocates what it is told to."""
    pytest.importorskip("meshio")
    monkeypatch.setattr(mesh_io, "_SECONDS", 1)
    head = "Begin ModelPartData\nEnd ModelPartData\n"
    path = write(tmp_path / "a.mdpa", head + "Begin Nodes\n 1 0 0 0\n 2 1 0 0\n")
    with pytest.raises(FormatError, match=r"a\.mdpa: meshio failed with .* 1 s"):
        read_mesh(path)
    grid = "STRUCTURED_POINTS\nDIMENSIONS 1000 1000 1000\nORIGIN 0 0 0\nSPACING 1 1 1\n"
    path = write(tmp_path / "a.vtk", f"# vtk DataFile Version 5.1\na\nASCII\nDATASET {grid}")
    with pytest.raises(FormatError, match=r"a\.vtk: meshio cannot read it \(.*MemoryError"):
        read_mesh(path)


def test_tetrahedra_from_a_file(tmp_path):
    meshio = pytest.importorskip("meshio")
    beam = box_tetrahedra((2, 1, 1), (2, 1, 1))
    cells = [("triangle", beam.surface_faces), ("tetra", beam.tetrahedra)]
    for suffix in ("vtk", "msh"):
        meshio.Mesh(beam.vertices, cells).write(tmp_path / f"beam.{suffix}")
        again = read_mesh(tmp_path / f"beam.{suffix}")
        assert isinstance(again, TetMesh)
        assert again.volume == pytest.approx(2)
        np.testing.assert_array_equal(again.tetrahedra, beam.tetrahedra)


@pytest.mark.parametrize("name", ["x.ply", "x.vtk", "x.msh", "x.nosuchformat"])
def test_broken_files_of_other_formats(tmp_path, name):
    pytest.importorskip("meshio")
    path = write(tmp_path / name, "nonsense\n1 2 3\n")
    with pytest.raises(FormatError, match=name):
        read_mesh(path)


def test_a_reader_that_ends_its_process_gives_up(tmp_path):
    pytest.importorskip("meshio")
    path = write(tmp_path / "x.stl", "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n")
    with pytest.raises(FormatError, match=r"x\.stl: meshio cannot read it \(it gave up\)"):
        read_mesh(path)


def test_a_ply_file_cut_in_its_header(tmp_path):
    path = write(tmp_path / "x.ply", "ply\nformat ascii 1.0\nelement vertex 3\n")
    with pytest.raises(FormatError, match="end_header"):
        read_mesh(path)


def test_missing_file():
    for name in ("nowhere.obj", "nowhere.ply"):
        with pytest.raises(FileNotFoundError):
            read_mesh(name)


def test_without_meshio_the_extra_is_named(tmp_path):
    path = write(tmp_path / "x.ply", "ply\nend_header\n")
    code = (
        "import sys; sys.modules['meshio'] = None; import substep\n"
        f"substep.geometry.read_mesh({str(path)!r})"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=os.environ, timeout=60
    )
    assert "pip install substep[mesh]" in done.stderr.splitlines()[-1]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
@pytest.mark.parametrize("name", ["a.obj", "a.ply"])
def test_what_is_no_file_is_refused_and_not_waited_for(tmp_path, name):
    os.mkfifo(tmp_path / name)
    (tmp_path / "folder.obj").mkdir()
    for path in (tmp_path / name, "/dev/zero", tmp_path / "folder.obj"):
        with pytest.raises(FormatError, match="expected a file, got a folder, a pipe or a device"):
            read_mesh(path)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_copies(copied):
    mesh = sphere_mesh(subdivisions=1)
    mesh.nearest([[0, 0, 0]])
    mesh._set(dropped=2)
    other = copied(mesh)
    assert str(other.report()) == str(mesh.report()) and other.dropped == 2
    np.testing.assert_array_equal(other.vertices, mesh.vertices)
    solid = box_tetrahedra((1, 1, 1), (1, 1, 1))
    solid.lacks.append("something")
    again = copied(solid)
    assert again.lacks == ["something"] and not again.vertices.flags.writeable


V = np.eye(4, 3)
BAD = {
    "negative": (lambda: TriangleMesh(V, [[0, 1, -1]]), r"faces\[0, 2\].*-1"),
    "n": (lambda: TriangleMesh(V, [[0, 1, 2], [0, 4, 1]]), r"faces\[1, 1\].*got 4"),
    "2**31": (lambda: TriangleMesh(V, [[0, 1, 2**31]]), r"faces\[0, 2\]"),
    "2**63": (lambda: TriangleMesh(V, np.array([[0, 1, 2**63]], np.uint64)), r"faces\[0, 2\]"),
    "repeated": (lambda: TriangleMesh(V, [[0, 1, 2], [0, 3, 3]]), r"faces\[1\].*different"),
    "empty": (lambda: TriangleMesh(V, np.empty((0, 3), int)), "at least one row"),
    "float": (lambda: TriangleMesh(V, [[0.0, 1.0, 2.0]]), "expected integers"),
    "quads": (lambda: TriangleMesh(V, [[0, 1, 2, 3]]), "rows? of 3"),
    "nan": (lambda: TriangleMesh([[0, 0, np.nan]], [[0, 1, 2]]), r"vertices\[0, 2\]"),
    "plane": (lambda: TriangleMesh(np.eye(3)[:, :2], [[0, 1, 2]]), "vertices"),
    "flat": (lambda: TetMesh(np.zeros((4, 3)), [[0, 1, 2, 3]]), r"tetrahedra\[0\]: no volume"),
    "tet": (lambda: TetMesh(V, [[0, 1, 2, 4]]), r"tetrahedra\[0, 3\]"),
    "radius": (lambda: sphere_mesh(0), "radius"),
    "grid": (lambda: grid_mesh(1, 5), "n: expected"),
    "size": (lambda: grid_mesh(2, 5, (1, 0)), "size"),
    "divisions": (lambda: box_tetrahedra((1, 1, 1), (1, 0, 1)), r"divisions\[1\]"),
    "lengths": (lambda: box_tetrahedra((1, -1, 1), (1, 1, 1)), "lengths"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input(name):
    make, said = BAD[name]
    with pytest.raises(InputError, match=said):
        make()


@pytest.mark.parametrize("faces", [[["a", "b", "c"]], [[0j, 1, 2]], np.array([[None, 1, 2]])])
def test_indices_that_are_no_numbers(faces):
    with pytest.raises(TypeError, match="faces: expected integers"):
        TriangleMesh(V, faces)


def test_masked_and_ragged_indices():
    with pytest.raises(InputError, match="masked"):
        TriangleMesh(V, np.ma.masked_equal([[0, 1, 2]], 1))
    with pytest.raises(InputError, match="faces: expected rows of"):
        TriangleMesh(V, [[0, 1, 2], [0, 1]])


def test_the_callers_arrays_are_copied():
    x, f = V.copy(), np.array([[0, 1, 2]])
    mesh = TriangleMesh(x, f)
    x[:], f[:] = 7, 3
    assert mesh.vertices[0, 0] == 1 and mesh.faces[0, 1] == 1
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0, 0] = 2
    assert substep.geometry.MeshReport.__doc__
