"""The surface of a liquid: where it should be, closed, and the same every time."""

import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import substep
from substep.geometry import TriangleMesh, surface_process

pysplashsurf = pytest.importorskip("pysplashsurf", reason="pysplashsurf is not installed")


def block(n=12, spacing=0.1, seed=0):
    """A cube of n^3 particles that jitter about a lattice."""
    cells = np.stack(np.meshgrid(*3 * [np.arange(n) + 0.5]), axis=-1).reshape(-1, 3)
    jitter = np.random.default_rng(seed).uniform(-0.15, 0.15, cells.shape)
    return (cells + jitter) * spacing


def mesh_of(surface):
    return TriangleMesh(surface.vertices, surface.faces)


@pytest.mark.parametrize("spacing", [1e-3, 0.1, 50.0])
def test_a_block_has_its_volume_and_a_closed_surface(spacing):
    surface = substep.liquid_surface(block(spacing=spacing), spacing / 2)
    mesh = mesh_of(surface)
    assert 0.88 < mesh.volume / (12 * spacing) ** 3 < 1  # its edges are rounded
    report = mesh.report()
    assert report.closed and report.non_manifold_edges == 0
    ends = np.array([surface.vertices.min(axis=0), surface.vertices.max(axis=0)]) / spacing
    np.testing.assert_allclose(ends, [[0] * 3, [12] * 3], atol=0.35)
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1, rtol=1e-5)
    outwards = surface.vertices / spacing - 6
    assert (np.einsum("ij,ij->i", surface.normals, outwards) > 0).all()


def test_lengths_of_pysplashsurf_are_multiples_of_the_radius():
    """Its docstring of reconstruct_surface says otherwise; `liquid_surface` relies on it."""
    counts = {
        scale: len(
            pysplashsurf.reconstruct_surface(
                (block() * scale).astype(np.float32),
                particle_radius=0.05 * scale,
                smoothing_length=2.0,
                cube_size=1.0,
            ).mesh.triangles
        )
        for scale in (1.0, 64.0, 1 / 64)
    }
    assert len(set(counts.values())) == 1 and 9000 < counts[1.0] < 10_000


def test_finer_cells_and_less_smoothing():
    points = block()
    coarse, fine = (substep.liquid_surface(points, 0.05, cell=c) for c in (2.0, 0.5))
    assert 10 * len(coarse.faces) < len(fine.faces)
    rough = substep.liquid_surface(points, 0.05, smoothing=0)
    areas = [mesh_of(s).area for s in (rough, substep.liquid_surface(points, 0.05, smoothing=50))]
    assert areas[1] < 0.99 * areas[0]


def test_the_same_bits_every_time_and_none_of_the_input_changes():
    points = block(20)
    before = substep.state_hash(points)
    runs = [substep.liquid_surface(points, 0.05) for _ in range(3)]
    assert len({substep.state_hash(s.vertices, s.faces, s.normals) for s in runs}) == 1
    assert substep.state_hash(points) == before


def test_far_away_it_is_the_same():
    here = substep.liquid_surface(block(), 0.05)
    there = substep.liquid_surface(block() + 1000.0, 0.05)
    assert mesh_of(there).volume == pytest.approx(mesh_of(here).volume, rel=1e-4)
    np.testing.assert_allclose(
        there.vertices.mean(axis=0) - 1000, here.vertices.mean(axis=0), atol=1e-3
    )


@pytest.mark.parametrize("count", [1, 2, 10])
def test_few_particles_are_drops(count):
    """Also coincident ones; a drop's volume is about that of its particle."""
    apart = substep.liquid_surface(np.arange(count)[:, None] * [0.0, 0.0, 1.0], 0.05)
    assert mesh_of(apart).report().components == count
    assert 0.1 < mesh_of(apart).volume / (count * 0.1**3) < 1.5
    same = substep.liquid_surface(np.zeros((count, 3)), 0.05)
    assert mesh_of(same).report().components == 1


def test_no_particles_no_surface():
    surface = substep.liquid_surface(np.zeros((0, 3)), 0.05)
    assert surface.vertices.shape == surface.normals.shape == (0, 3)
    assert surface.faces.shape == (0, 3) and surface.faces.dtype == np.int64


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"positions": [[0.0, 0.0, np.nan]]}, substep.InputError, r"positions\[0, 2\]"),
        ({"positions": np.zeros((4, 2))}, substep.InputError, "positions: expected shape"),
        ({"positions": [["a", "b", "c"]]}, TypeError, "positions: expected real numbers"),
        ({"positions": [[0, 0, 0], [1e30, 0, 0]]}, substep.InputError, "spread over 1e.30 m"),
        ({"radius": 0.0}, substep.InputError, "radius: expected a number above 0"),
        ({"radius": np.nan}, substep.InputError, "radius"),
        ({"radius": 1e-12}, substep.InputError, "positions: spread over"),
        ({"cell": 0.01}, substep.InputError, "cell: expected a number from 0.1 to 4, got 0.01"),
        ({"cell": np.inf}, substep.InputError, "cell"),
        ({"smoothing": -1}, substep.InputError, "smoothing: expected an integer"),
        ({"smoothing": 2.5}, substep.InputError, "smoothing: expected an integer"),
    ],
)
def test_bad_input(changes, error, words):
    arguments = {"positions": block(3), "radius": 0.05, **changes}
    with pytest.raises(error, match=words):
        substep.liquid_surface(arguments.pop("positions"), arguments.pop("radius"), **arguments)


def test_a_missing_library_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pysplashsurf", None)
    with pytest.raises(ImportError, match=r'pip install "substep\[surface\]" for surfaces'):
        substep.liquid_surface(block(2), 0.05)


@pytest.mark.skipif(sys.platform != "linux", reason="limits memory")
def test_memory_that_runs_out_ends_no_process():
    """pysplashsurf ends its own by SIGABRT where memory runs out."""
    program = """if True:
        import resource
        import numpy as np
        import substep
        points = np.stack(np.meshgrid(*3 * [np.arange(30.0)]), axis=-1).reshape(-1, 3)
        resource.setrlimit(resource.RLIMIT_AS, (300 << 20, resource.RLIM_INFINITY))
        try:
            substep.liquid_surface(points, 0.5, cell=0.25)
        except MemoryError as error:
            print(error)
        resource.setrlimit(resource.RLIMIT_AS, 2 * (resource.RLIM_INFINITY,))
        print(len(substep.liquid_surface(points[:1], 0.5).vertices) > 0)
        """
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout == "liquid_surface: out of memory\nTrue\n", done


def test_an_interrupt_ends_it():
    points = np.stack(np.meshgrid(*3 * [np.arange(40.0)]), axis=-1).reshape(-1, 3)
    timer = threading.Timer(0.5, signal.raise_signal, [signal.SIGINT])
    timer.start()
    begin = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        substep.liquid_surface(points, 0.5, cell=0.1)  # some 20 s
    assert time.perf_counter() - begin < 5


def test_what_pysplashsurf_says_is_told(monkeypatch):
    monkeypatch.setattr(surface_process, "__file__", "/dev/null/not")
    with pytest.raises(substep.SolverError, match=r"pysplashsurf failed .*not"):
        substep.liquid_surface(block(2), 0.05)
