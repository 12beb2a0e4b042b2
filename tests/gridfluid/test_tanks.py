"""Tanks that are shaken: the frame's force on each particle, given anew in each step."""

import math

import numpy as np
import pytest
import substep

G = 9.81
LENGTH, DEPTH, PERIOD = 1.73, 0.6, 1.3  # of Faltinsen et al.: tank and water [m], shaking [s]


def shake(n, amplitude, duration, look, transfer="apic"):
    """Of a tank that moves by amplitude cos(2 pi t / PERIOD): what look gives after each step."""
    cell, rate = LENGTH / n, 2 * math.pi / PERIOD
    x = substep.fill_box((0, 0), (LENGTH, DEPTH), cell / 2)
    bounds = ((0, 0), (LENGTH, cell * math.ceil(1.15 / cell)))
    water = substep.GridLiquid(x, cell=cell, bounds=bounds, transfer=transfer, threads=1)
    still = look(water)
    times, values = [], []
    while water.time < duration:
        push = amplitude * rate**2 * math.cos(rate * water.time)
        water.set_forces(water.masses[:, None] * [push, 0.0])
        water.step(0.64 / n)
        times.append(water.time)
        values.append(look(water) - still)
    return np.array(times), np.array(values)


@pytest.mark.parametrize("transfer", ["apic", "flip"])
def test_a_shaken_tank_answers_as_linear_waves_do(transfer):
    """Its first mode: a'' + w1^2 a = -k tanh(kh) (4 L / pi^2) s, s the shaking's acceleration."""
    k, amplitude = math.pi / LENGTH, 0.004
    times, found = shake(
        64, amplitude, 4.0, lambda water: np.cos(k * water.positions[:, 0]).mean(), transfer
    )
    shaken, own = 2 * math.pi / PERIOD, math.sqrt(G * k * math.tanh(k * DEPTH))
    most = -k * math.tanh(k * DEPTH) * 4 * LENGTH / math.pi**2 * amplitude * shaken**2
    mode = most / (own**2 - shaken**2) * (np.cos(shaken * times) - np.cos(own * times))
    expected = mode / (2 * DEPTH)
    assert np.abs(found - expected).max() < 0.05 * np.abs(expected).max()


# Faltinsen, Rognebakke, Lukovsky and Timokha 2000, J. Fluid Mech. 407, Fig. 7, read off: the rise
# at 0.05 m from the left wall, (s, m), where it turns and between.
RISE = np.array([
    [0.36, -0.0238], [0.78, 0.0087], [1.16, 0.0754], [1.42, 0.0248], [1.76, -0.0796],
    [2.11, -0.0558], [2.31, 0.0601], [2.57, 0.1421], [2.84, 0.0588], [3.27, -0.0925],
    [3.70, 0.0206], [4.04, 0.1093], [4.32, 0.0223], [4.57, -0.0405], [5.29, 0.0126],
    [6.43, 0.0325], [7.00, -0.0668], [7.41, 0.0238], [7.71, 0.1248], [8.04, 0.0279],
    [8.30, -0.0825], [8.74, -0.0040], [9.07, 0.1302], [9.41, 0.0520], [9.58, -0.0558],
])  # fmt: skip


def test_sloshing_beats_as_in_the_experiment():
    """Shaken at 0.87 of the period of the first mode, by 32 mm; the start of it is not known."""
    times, rise = shake(64, 0.032, 9.6, lambda water: water.depth([[0.05]])[0])
    found = np.interp(RISE[:, 0], times, rise)
    assert np.abs(found - RISE[:, 1]).mean() < 0.16 * RISE[:, 1].max()
    assert np.corrcoef(found, RISE[:, 1])[0, 1] > 0.95
