"""The minimisers of implicit Euler's energy: Newton, and projective dynamics beside it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import substep
from substep import springs

H, GRAVITY = 1 / 60, np.array([0.0, -9.81, 0.0])


def cloth(n: int, **options: Any) -> substep.MassSpring:
    """0.3 kg and 1 m x 1 m, flat, held at two corners; gravity across."""
    axis = np.linspace(0, 1, n)
    x = np.array([(b, 0.0, a) for a in axis for b in axis])
    edges, stiffness = springs.grid_springs(n, n, stiffness=1e4)
    return substep.MassSpring(
        x, edges, stiffness, 0.3 / n**2, pinned=[0, n - 1], gravity=GRAVITY, step=H, **options
    )


def energy(net: substep.MassSpring, x: Any, x_n: Any, v_n: Any) -> float:
    """E(x) of docs/springs.md, without damping."""
    free = ~net.pinned
    y = x_n + H * v_n + H**2 * GRAVITY
    inertia = (net.masses[free, None] * (x - y)[free] ** 2).sum() / (2 * H**2)
    lengths = np.linalg.norm(x[net.edges[:, 0]] - x[net.edges[:, 1]], axis=1)
    return float(inertia + (net.stiffness * (lengths - net.rest_lengths) ** 2).sum() / 2)


def test_newton_reaches_its_tolerance_in_few_iterations() -> None:
    net, counts = cloth(24), []
    for _ in range(20):
        net.step()
        counts.append(net.report.iterations)
        assert net.report.converged
        assert net.report.subdivided == 0
        assert net.report.residuals[-1] <= 1e-3 * 9.81 * 0.3 / 24**2
    assert np.mean(counts) < 10  # 18 with the projected Hessian


@pytest.mark.figure
def test_a_folding_cloth_takes_few_factorizations() -> None:
    # Without quasi-Newton steps between them 10.7 factorizations and 8.6 iterations a step.
    net, reports = cloth(48), []
    for _ in range(12):
        net.step()
        reports.append(net.report)
        assert net.report.residuals[-1] <= 1e-3 * 9.81 * 0.3 / 48**2
    assert np.mean([report.factorizations for report in reports]) < 6
    assert np.mean([report.iterations for report in reports]) < 5
    assert max(report.refinements for report in reports) > 0


def test_cloth_on_a_ball_takes_few_iterations() -> None:
    # 47 iterations and 63 factorizations a step where each minimisation under lagged friction is to
    # the tolerance and has no quasi-Newton steps.
    n, axis = 24, np.linspace(-0.5, 0.5, 24)
    x = np.array([(b, a, 0.36) for a in axis for b in axis])
    edges, stiffness = springs.grid_springs(n, n, stiffness=1e4)
    ball = substep.Collider(substep.Sphere(0.25), friction=0.3)
    net = substep.MassSpring(
        x, edges, stiffness, 0.3 / n**2, colliders=[ball], contact_margin=2e-3, step=H
    )
    reports = []
    for _ in range(14):
        net.step()
        reports.append(net.report)
        assert net.report.friction_converged
        assert net.report.residuals[-1] <= 1e-3 * 9.81 * 0.3 / n**2
    touching = [report for report in reports if report.iterations > 2]
    assert len(touching) > 4
    assert np.mean([report.iterations for report in touching]) < 20
    assert np.mean([report.factorizations for report in touching]) < 25


def test_projective_iterations_lower_the_energy_to_that_of_newton() -> None:
    exact = cloth(8, tolerance=1e-10)
    exact.advance(3 * H)
    start = exact.state()
    exact.step()
    lowest = energy(exact, exact.positions, start["positions"], start["velocities"])
    last, gaps = np.inf, []
    for iterations in (1, 2, 5, 10, 100, 10000):
        net = cloth(8, solver="projective", max_iterations=iterations)
        net.restore(start)
        net.step()
        assert net.report.iterations == iterations
        value = energy(net, net.positions, start["positions"], start["velocities"])
        assert lowest * (1 - 1e-12) <= value < last
        last = value
        gaps.append(value / lowest - 1)
    assert gaps[-1] < 1e-4 < 0.1 < gaps[0]


def test_projective_factorizes_again_when_the_step_or_the_pins_change() -> None:
    net, factorizations = cloth(6, solver="projective"), []
    for change in ("", "", "step", "pins"):
        if change == "pins":
            net.pinned = [0]
        net.step(H / 2 if change == "step" else None)
        factorizations.append(net.report.factorizations)
    assert factorizations == [1, 0, 1, 1]


def test_projective_with_damping_and_drag_falls_to_rest() -> None:
    net = cloth(6, solver="projective", max_iterations=50, damping=5.0, drag=4.0)
    net.advance(4.0)
    still = cloth(6, damping=5.0, drag=4.0)
    still.advance(4.0)
    heights = net.positions[:, 1].mean(), still.positions[:, 1].mean()
    assert heights[0] == pytest.approx(heights[1], rel=0.01)
    assert np.abs(net.velocities).max() < 0.3


@pytest.mark.parametrize("solver", ["newton", "projective"])
def test_the_bits_do_not_depend_on_threads(solver: str) -> None:
    hashes = set()
    for threads in (1, 2, 3):
        net = cloth(48, solver=solver, threads=threads)
        net.advance(2 * H)
        hashes.add(substep.state_hash(net.positions, net.velocities))
    assert len(hashes) == 1


def test_projective_refuses_contact() -> None:
    ground = substep.Collider(substep.geometry.Plane([0, 1, 0], [0, -1, 0]))
    with pytest.raises(substep.InputError, match="colliders"):
        cloth(4, solver="projective", colliders=[ground])


@pytest.mark.parametrize("turning", [0.0, 3.0])
def test_a_ball_that_turns_under_a_cloth_costs_no_iterations(turning):
    """Without friction it is the same ball; vertices that went along with it took 28 a step."""
    n = 16
    axis = np.linspace(-0.3, 0.3, n)
    edges, stiffness = substep.springs.grid_springs(n, n, stiffness=1e3)
    ball = substep.Collider(substep.Sphere(0.3), friction=0.0, angular_velocity=(0, 0, turning))
    cloth = substep.MassSpring(
        np.array([(a, b, 0.31) for b in axis for a in axis]),
        edges,
        stiffness,
        0.1 / n**2,
        colliders=[ball],
    )
    counts = []
    for _ in range(20):
        cloth.step(1 / 60)
        counts.append(cloth.report.iterations)
    assert np.mean(counts) < 8
