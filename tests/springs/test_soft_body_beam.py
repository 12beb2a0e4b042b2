"""Soft bodies against the closed forms of beams, and on the meshes of other people.

The beam is 1 m long and 1/20 m high and wide, so that shear adds 0.15 % to its deflection
(Timoshenko), of nu = 0, because the closed forms know no lateral contraction. n cells of six
tetrahedra across its height, 30 n along, each 2/3 as long as high, and two across its width, along
which nothing varies.
"""

import math
from pathlib import Path

import numpy as np
import pytest
import substep
from substep.geometry import box_tetrahedra

LENGTH, HEIGHT, MODULUS, DENSITY = 1.0, 0.05, 1e7, 1000.0
INERTIA, LINE = HEIGHT**4 / 12, DENSITY * HEIGHT**2  # of the section, and mass per length
CELLS = (4, 8, 16)
MESHES = Path(__file__).parents[3] / "shared" / "data" / "meshes"
OPTIONS = {"density": DENSITY, "young_modulus": MODULUS, "poisson_ratio": 0.0}


class Beam:
    """Clamped at its left end; y is up."""

    def __init__(self, cells, **options):
        mesh = box_tetrahedra((LENGTH, HEIGHT, HEIGHT), (30 * cells, cells, 2))
        self.rest = mesh.vertices
        left, right = self.rest[:, 0].min(), self.rest[:, 0].max()
        self.tip = self.rest[:, 0] == right
        pinned = self.rest[:, 0] == left
        self.body = substep.SoftBody(
            self.rest, mesh.tetrahedra, pinned=pinned, **{**OPTIONS, **options}
        )

    def load(self):
        """A unit force [N] down, spread over the face at the tip."""
        edge = np.abs(self.rest[self.tip, 1:]) > 0.49 * HEIGHT
        weights = np.where(edge, 0.5, 1.0).prod(axis=1)
        forces = np.zeros_like(self.rest)
        forces[self.tip, 1] = -weights / weights.sum()
        return forces

    def deflection(self):
        return -(self.body.positions - self.rest)[self.tip, 1].mean()


def relative_errors(measure, cells=CELLS):
    return [measure(n) - 1 for n in cells]


def check_convergence(errors):
    """Of second order, from the stiff side or beyond, and 1 % on the finest mesh."""
    print("relative errors:", " ".join(f"{e:+.4f}" for e in errors))
    assert abs(errors[2]) < 0.01
    assert abs(errors[2]) < 0.35 * abs(errors[1]) < 0.35**2 * abs(errors[0])


@pytest.mark.slow
def test_a_load_at_the_tip_bends_a_beam():
    """F L^3 / (3 E I)."""

    force = 1e-4 * 3 * MODULUS * INERTIA / LENGTH**3  # lets the tip fall by 1e-4 m

    def measure(cells):
        beam = Beam(cells, gravity=(0, 0, 0), tolerance=1e-6 * force)
        beam.body.forces[:] = force * beam.load()
        beam.body.step(1e4)  # so long that inertia is nothing
        return beam.deflection() / 1e-4

    check_convergence(relative_errors(measure))


@pytest.mark.slow
def test_its_weight_bends_a_beam():
    """q L^4 / (8 E I)."""

    gravity = 1e-4 * 8 * MODULUS * INERTIA / LENGTH**4 / LINE

    def measure(cells):
        beam = Beam(cells, gravity=(0, -gravity, 0), tolerance=1e-6 * LINE * gravity)
        beam.body.step(1e4)
        return beam.deflection() / 1e-4

    check_convergence(relative_errors(measure))


def decay(samples):
    """z of u_n = Re(a z^n), from u_{n+1} = 2 Re(z) u_n - |z|^2 u_{n-1} by least squares."""
    u = np.asarray(samples)
    rows = np.stack([u[1:-1], u[:-2]], axis=1)
    twice_real, minus_square = np.linalg.lstsq(rows, u[2:], rcond=None)[0]
    return complex(twice_real / 2, math.sqrt(-minus_square - twice_real**2 / 4))


@pytest.mark.slow
def test_the_first_frequency_of_a_beam():
    """omega = 1.87510407^2 / L^2 sqrt(E I / (rho A)).

    A step of implicit Euler multiplies a mode by z = 1 / (1 - i omega h), so that omega h is the
    tangent of its angle: the damping of the method does not change what is measured.
    """

    exact = 1.87510407**2 / LENGTH**2 * math.sqrt(MODULUS * INERTIA / LINE)
    force = 1e-4 * 3 * MODULUS * INERTIA / LENGTH**3

    def measure(cells):
        beam = Beam(cells, gravity=(0, 0, 0), tolerance=1e-6 * force)
        beam.body.forces[:] = force * beam.load()
        beam.body.step(1e4)
        beam.body.velocities[:] = 0
        h = 0.1 / exact
        samples = []
        for _ in range(24):
            beam.body.step(h)
            samples.append(beam.deflection())
        z = decay(samples[4:])  # higher modes are gone
        return math.tan(abs(math.atan2(z.imag, z.real))) / h / exact

    check_convergence(relative_errors(measure))


@pytest.mark.slow
def test_the_elastica():
    """Large deflection under a dead load: F L^2 / (E I) = 2 (Bisshopp and Drucker, 1945)."""
    down, along = 0.493457, 0.839358  # by shooting
    force = 2 * MODULUS * INERTIA / LENGTH**2
    errors = []
    for cells in CELLS:
        beam = Beam(cells, gravity=(0, 0, 0), tolerance=1e-5 * force)
        for k in range(1, 5):
            beam.body.forces[:] = k / 4 * force * beam.load()
            beam.body.step(1e4)
        tip = (beam.body.positions - beam.rest)[beam.tip].mean(axis=0)
        errors.append((-tip[1] / LENGTH / down - 1, (1 + tip[0] / LENGTH) / along - 1))
    for component in zip(*errors, strict=True):
        check_convergence(component)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["spot", "stanford-bunny", "teapot"])
def test_the_meshes_of_other_people_fall_and_come_to_rest(name):
    path = MESHES / f"{name}.obj"
    if not path.exists():
        pytest.skip("the meshes are not here")
    surface = substep.geometry.read_mesh(path)
    sides = np.ptp(surface.vertices, axis=0)
    scale = 0.2 / sides.max()  # 0.2 m long, y up in the file
    vertices = scale * surface.vertices[:, [0, 2, 1]] * [1, -1, 1]
    vertices[:, 2] -= vertices[:, 2].min() - 0.05
    surface = substep.geometry.TriangleMesh(vertices, surface.faces)
    ground = substep.Collider(substep.Plane(), friction=0.5)
    body = substep.SoftBody.from_mesh(
        surface,
        spacing=0.2 / 12,
        density=1000.0,
        young_modulus=3e4,
        poisson_ratio=0.4,
        damping_time=0.02,
        colliders=[ground],
        step=1 / 60,
    )
    if name == "teapot":
        assert any("open" in phrase or "manifold" in phrase for phrase in body.mesh.lacks)
    impulse = 0.0
    for _ in range(60):
        body.step()
        assert ground.distance(body.positions).min() > 0
        impulse -= ground.impulse[2]
    corners = body.positions[body.mesh.tetrahedra]
    assert (np.linalg.det(corners[:, 1:] - corners[:, :1]) > 0).all()
    weight = 9.81 * body.masses.sum()
    fall = float(body.masses @ body.velocities[:, 2])
    assert impulse == pytest.approx(weight * 1.0 + fall, rel=1e-3)  # all that stopped it
    assert np.abs(body.velocities).mean() < 0.5
