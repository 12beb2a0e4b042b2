"""The list of all cases: name, method, source, figure, band and what measures it.

Bands are those of the project's own tests, or wider where a case is coarser or longer. Controls
are cases that are set up wrongly, by a step beyond the limit or a wrong parameter: they show that
the band would notice.
"""

from __future__ import annotations

import math
from functools import partial

from ..base.checks import check_choice
from . import (
    advection,
    coupling,
    grid_flow,
    grid_liquid,
    mpm,
    ode,
    pbd,
    pbf,
    rigid,
    soft_body,
    springs,
)
from .case import Case

G = 9.81
HNW, HW = "Hairer, Norsett, Wanner, Solving ODEs I", "Hairer, Wanner, Solving ODEs II"
SLOPE = G * (0.5 - 0.5 * math.cos(math.pi / 6))  # g (sin t - mu cos t), t = 30 degrees, mu = 0.5
SLOSHING = "Lamb, Hydrodynamics, art. 228: w^2 = g k tanh(k h)"
CAVITY_100 = "Marchi, Suero, Araki 2009: 1024^2 cells, extrapolated"
MARTIN_MOYCE = "Martin, Moyce 1952, Phil. Trans. R. Soc. A 244, Fig. 3"


def _omega(depth: float) -> float:
    """Of the first linear wave in a tank 1 m long [1/s]."""
    return math.sqrt(G * math.pi * math.tanh(math.pi * depth))


ODE = (
    *(
        Case(
            f"order of {method}",
            "ode",
            f"{HNW}, II.1" if method not in ("implicit_euler", "Radau") else f"{HW}, IV",
            order,
            partial(ode.order, method, order),
            absolute=0.1 if order <= 5 else 0.4,
        )
        for method, order in (
            ("euler", 1),
            ("midpoint", 2),
            ("heun", 2),
            ("rk4", 4),
            ("RK45", 5),
            ("DOP853", 8),
            ("RKC2", 2),
            ("implicit_euler", 1),
            ("Radau", 5),
        )
    ),
    *(
        Case(
            f"order of {method}",
            "ode",
            "Hairer, Lubich, Wanner, Geometric Numerical Integration, I-II",
            order,
            partial(ode.second_order_order, method, counts),
            absolute=0.1,
        )
        for method, order, counts in (
            ("symplectic_euler", 1, (2000, 4000)),
            ("velocity_verlet", 2, (500, 1000)),
            ("yoshida4", 4, (100, 200)),
        )
    ),
    Case(
        "growth of an oscillation by a step of explicit Euler, h omega = 1",
        "ode",
        "|1 + i z| = sqrt(1 + z^2)",
        math.sqrt(2),
        partial(ode.growth, "euler", 1j),
        relative=1e-12,
    ),
    Case(
        "damping of an oscillation by a step of implicit Euler, h omega = 1",
        "ode",
        "1 / |1 - i z| = 1 / sqrt(1 + z^2)",
        math.sqrt(0.5),
        partial(ode.growth, "implicit_euler", 1j),
        relative=1e-9,
    ),
    Case(
        "damping of an oscillation by a step of Radau IIA, h omega = 1",
        "ode",
        f"{HW}, IV.3, table 3.1: Pade approximation (2, 3)",
        abs((1 + 0.4j - 1 / 20) / (1 - 0.6j - 3 / 20 + 1j / 60)),
        partial(ode.growth, "Radau", 1j),
        relative=1e-9,
    ),
    *(
        Case(
            f"largest stable h |lambda| of {method}, {kind}",
            "ode",
            f"{HW}, IV.2",
            limit,
            partial(ode.largest_step, method, direction, 4.0),
            relative=1e-4,
        )
        for method, kind, direction, limit in (
            ("euler", "decay", -1, 2.0),
            ("rk4", "decay", -1, 2.785293563),
            ("rk4", "oscillation", 1j, 2 * math.sqrt(2)),
            ("RK45", "decay", -1, 3.306567892),
        )
    ),
    Case(
        "reach of RKC2 with 10 stages over its stages squared",
        "ode",
        "Sommeijer, Shampine, Verwer 1998, eq. 2.4: 2/3 (s^2 - 1) (1 - 2/15 eps)",
        2 / 3 * 0.99 * (1 - 2 / 15 * 2 / 13),
        partial(ode.damping_left, 10),
        relative=0.01,
    ),
    Case(
        "explicit Euler just below its limit decays",
        "ode",
        "|1 - z| < 1 for z < 2",
        0.0,
        partial(ode.bounded_decay, "euler", 1.9),
        absolute=1e-3,
    ),
    Case(
        "explicit Euler beyond its limit does not decay",
        "ode",
        "|1 - z| > 1 for z > 2",
        0.0,
        partial(ode.bounded_decay, "euler", 2.1),
        absolute=1e-3,
        control=True,
    ),
    Case(
        "Arenstorf orbit: distance from its start after a period",
        "ode",
        f"{HNW}, II.0",
        0.0,
        ode.arenstorf,
        absolute=1e-8,
    ),
    Case(
        "Pleiades: place of the first star at t = 3",
        "ode",
        f"{HNW}, II.10; Mazzia, Magherini, Test Set for IVP Solvers",
        0.3706139143970502,
        ode.pleiades,
        relative=1e-6,
    ),
    Case(
        "Robertson: first species at t = 1e11",
        "ode",
        "Mazzia, Magherini, Test Set for IVP Solvers (ROBER)",
        0.2083340149701255e-7,
        ode.robertson,
        relative=1e-6,
    ),
    *(
        Case(
            f"Kepler orbit, eccentricity 0.5: error of the energy by {method}, 100 orbits",
            "ode",
            "Hairer, Lubich, Wanner, Geometric Numerical Integration, IX: it does not drift",
            0.0,
            partial(ode.kepler_energy, method, 0.01),
            absolute=most,
        )
        for method, most in (("velocity_verlet", 1e-3), ("yoshida4", 1e-5))
    ),
)

FIELDS = (
    Case(
        "rigid rotation: distance from the start after a turn",
        "fields",
        "closed form: 0; rk4 leaves (2 pi)^5 h^4 / 120",
        (2 * math.pi) ** 5 / 200**4 / 120,
        partial(advection.turned, "rk4"),
        relative=0.01,
        unit="m",
    ),
    Case(
        "steady eddy: change of the stream function along paths",
        "fields",
        "closed form: paths are its level lines",
        0.0,
        advection.stream_function,
        absolute=1e-8,
        unit="m^2/s",
    ),
    Case(
        "steady eddy by explicit Euler: paths spiral outwards",
        "fields",
        "closed form: paths are its level lines",
        0.0,
        partial(advection.stream_function, "euler"),
        absolute=1e-8,
        unit="m^2/s",
        control=True,
    ),
)

SPRINGS = (
    Case(
        "sag of a chain of 1.5 m over 1 m",
        "springs",
        "catenary: 2 a sinh(d / 2 a) = L",
        0.50263326,
        partial(springs.catenary, 32),
        relative=0.01,
        unit="m",
    ),
    Case(
        "extension of a rod that hangs",
        "springs",
        "m g L / (2 E A)",
        3 * G * 2 / (2 * 5000),
        springs.rod,
        relative=1e-6,
        unit="m",
    ),
    Case(
        "sag of a square membrane",
        "springs",
        "Timoshenko, Woinowsky-Krieger, Theory of Plates and Shells, sec. 44",
        0.0736713532814,
        partial(springs.membrane, 33),
        relative=0.01,
    ),
    Case(
        "period of an oscillator by velocity Verlet, h omega = 0.1",
        "springs",
        "discrete closed form: sin(w' h / 2) = w h / 2",
        math.pi * 0.01 / math.asin(0.05),
        partial(springs.period, "velocity_verlet", 0.01),
        relative=1e-3,
        unit="s",
    ),
    Case(
        "damping of an oscillator by a step of implicit Euler, h omega = 1",
        "springs",
        "1 / sqrt(1 + z^2)",
        math.sqrt(0.5),
        partial(springs.amplitude_left, "implicit_euler", 0.1),
        relative=1e-6,
    ),
    Case(
        "explicit Euler does not damp an oscillator",
        "springs",
        "1 / sqrt(1 + z^2) is that of the implicit one",
        math.sqrt(0.5),
        partial(springs.amplitude_left, "euler", 0.1),
        relative=1e-6,
        control=True,
    ),
    Case(
        "damped oscillator after 2 s",
        "springs",
        "exp(-zeta w t) (cos w' t + zeta w / w' sin w' t), zeta = 0.1",
        0.007911602361896251,
        springs.decay,
        absolute=1e-5,
        unit="m",
    ),
    Case(
        "cloth slides down 30 degrees, friction 0.5, for 2 s",
        "springs",
        "Coulomb: (sin t - mu cos t) g t",
        2 * SLOPE,
        partial(springs.sliding_speed, 30, 0.5),
        relative=0.05,
        unit="m/s",
    ),
    Case(
        "cloth stays on 26 degrees, friction 0.5",
        "springs",
        "Coulomb: below atan mu = 26.6 degrees",
        0.0,
        partial(springs.sliding_speed, 26, 0.5),
        absolute=1e-3,
        unit="m/s",
    ),
)

SOFT_BODY = (
    *(
        Case(
            f"deflection of a beam of {cells} x 2 cells over that of a slender one",
            "soft-body",
            "F L^3 / (3 E I)",
            1.0,
            partial(soft_body.cantilever, cells),
            relative=band,
            quick=cells < 16,
        )
        for cells, band in ((8, 0.05), (16, 0.01))
    ),
    Case(
        "a beam of 4 x 2 cells is too stiff for that",
        "soft-body",
        "F L^3 / (3 E I)",
        1.0,
        partial(soft_body.cantilever, 4),
        relative=0.05,
        control=True,
    ),
    Case(
        "energy of a free body that swings, change in 0.4 s",
        "soft-body",
        "conserved",
        0.0,
        partial(soft_body.energy_drift, 2e-4),
        absolute=0.01,
    ),
    Case(
        "momentum of a free body that swings",
        "soft-body",
        "conserved",
        0.0,
        soft_body.momentum_gained,
        absolute=1e-12,
    ),
)

PBD = (
    Case(
        "distance of XPBD from implicit Euler, one spring",
        "pbd",
        "Macklin, Mueller, Chentanez 2016, sec. 4",
        0.0,
        pbd.implicit_euler_error,
        absolute=1e-12,
        unit="m",
    ),
    *(
        Case(
            f"stretch of a spring of 1000 N/m by 2 kg, {substeps} sub-steps of 1/{rate} s",
            "pbd",
            "m g / k, whatever the step",
            2 * G / 1000,
            partial(pbd.rest_of_a_spring, 1 / rate, substeps, iterations),
            relative=1e-5,
            unit="m",
        )
        for rate, substeps, iterations in ((30, 1, 1), (240, 3, 5))
    ),
    Case(
        "stretch of the first of ten links by the chain below",
        "pbd",
        "alpha m g n",
        1e-4 * 0.5 * G * 10,
        partial(pbd.top_link, 10, 10),
        relative=0.01,
        unit="m",
    ),
    Case(
        "one iteration in one sub-step stretches that link too far",
        "pbd",
        "alpha m g n",
        1e-4 * 0.5 * G * 10,
        partial(pbd.top_link, 1, 1),
        relative=0.01,
        unit="m",
        control=True,
    ),
    Case(
        "period of a pendulum of 1 m, 5 degrees",
        "pbd",
        "2 pi sqrt(l / g) (1 + t^2 / 16)",
        2 * math.pi / math.sqrt(G) * (1 + math.radians(5) ** 2 / 16),
        pbd.pendulum_period,
        relative=2e-3,
        unit="s",
    ),
    Case(
        "a block slides down 30 degrees, friction 0.5, for 1 s",
        "pbd",
        "Coulomb: (sin t - mu cos t) g t",
        SLOPE,
        partial(pbd.sliding_speed, 30, 0.5),
        relative=0.05,
        unit="m/s",
    ),
    Case(
        "height after a bounce, restitution 0.5",
        "pbd",
        "e^2 h",
        0.25,
        partial(pbd.rebound, 0.5),
        relative=0.02,
        unit="m",
    ),
)

PBF = (
    Case(
        "a floor drags a puddle, friction 0.2, over g",
        "pbf",
        "Coulomb",
        0.2,
        partial(pbf.puddle, 0.2),
        relative=0.03,
    ),
    Case(
        "viscosity by which a shear wave decays",
        "pbf",
        "exp(-nu k^2 t)",
        0.1,
        partial(pbf.shear_wave, 0.1),
        relative=0.05,
        unit="m^2/s",
    ),
    Case(
        "the same wave in a liquid that is half as viscous",
        "pbf",
        "exp(-nu k^2 t)",
        0.1,
        partial(pbf.shear_wave, 0.05),
        relative=0.05,
        unit="m^2/s",
        control=True,
    ),
    Case(
        "load on the floor of a tank over the weight in it",
        "pbf",
        "closed form",
        1.0,
        pbf.weight_on_a_tank,
        relative=0.01,
    ),
    Case(
        "period of sloshing, 40 particles to 1 m",
        "pbf",
        SLOSHING,
        2 * math.pi / _omega(0.5),
        pbf.sloshing_period,
        relative=0.02,
        unit="s",
    ),
    *(
        Case(
            f"largest error of the front of a dam break, {cells} particles to its width",
            "pbf",
            MARTIN_MOYCE,
            0.0,
            partial(pbf.dam_break, cells),
            absolute=0.04,
            quick=cells < 20,
        )
        for cells in (12, 24)
    ),
)

RIGID = (
    Case(
        "half period of a plate that turns over",
        "rigid",
        "Landau, Lifshitz, Mechanics, sec. 37: 2 K(k) / lambda, integrated to 1e-12",
        4.538872,
        rigid.turns_over,
        absolute=5e-6,
        unit="s",
    ),
    Case(
        "rate at which the axis of a symmetric top goes round",
        "rigid",
        "Landau, Lifshitz, Mechanics, eq. 35.4: L / I_1",
        1.0,
        rigid.precession,
        relative=1e-10,
    ),
    *(
        Case(
            f"period of a pendulum, {degrees} degrees, over that of small swings",
            "rigid",
            "2 K(sin(t / 2)) / pi",
            figure,
            partial(rigid.pendulum, degrees),
            relative=1e-3,
        )
        for degrees, figure in ((30, 1.01741), (90, 1.18034))
    ),
    Case("fall in 2 s", "rigid", "g t^2 / 2", 2 * G, rigid.fall, relative=1e-10, unit="m"),
    Case(
        "a box slides down 30 degrees, friction 0.5",
        "rigid",
        "Coulomb: (sin t - mu cos t) g",
        SLOPE,
        partial(rigid.down_a_slope, "box", 30, 0.5),
        relative=1e-3,
        unit="m/s^2",
    ),
    Case(
        "the same box with friction 0.45",
        "rigid",
        "Coulomb: (sin t - mu cos t) g, mu = 0.5",
        SLOPE,
        partial(rigid.down_a_slope, "box", 30, 0.45),
        relative=1e-3,
        unit="m/s^2",
        control=True,
    ),
    Case(
        "a ball rolls down 20 degrees",
        "rigid",
        "5/7 g sin t",
        5 / 7 * G * math.sin(math.radians(20)),
        partial(rigid.down_a_slope, "ball", 20, 0.5),
        relative=1e-3,
        unit="m/s^2",
    ),
    Case(
        "speed of a thrown ball once it rolls",
        "rigid",
        "5/7 of the first",
        5 / 7,
        rigid.rolling_speed,
        relative=1e-3,
    ),
    Case(
        "height after a bounce, restitution 0.8",
        "rigid",
        "e^2 h",
        0.64,
        partial(rigid.rebound, 0.8),
        relative=2e-3,
        unit="m",
    ),
    Case(
        "speed of the last ball of Newton's cradle",
        "rigid",
        "momentum and energy",
        1.0,
        rigid.cradle,
        relative=1e-9,
        unit="m/s",
    ),
    Case(
        "a ball circles on a turntable, over the table's rate",
        "rigid",
        "Weltner 1979, Am. J. Phys. 47: 2/7",
        2 / 7,
        rigid.turntable,
        relative=1e-3,
    ),
    Case(
        "load of the first joint of a chain of ten",
        "rigid",
        "the weight below",
        1.0,
        rigid.chain_load,
        relative=1e-4,
    ),
    Case(
        "load of the floor below ten boxes",
        "rigid",
        "their weight",
        1.0,
        rigid.stack_load,
        relative=1e-4,
    ),
)

GRID_FLOW = (
    Case(
        "lid-driven cavity, Re 100, 64^2 cells: least velocity",
        "grid-flow",
        CAVITY_100,
        -0.2140417,
        partial(grid_flow.cavity, 100, (64, 12)),
        relative=0.01,
    ),
    Case(
        "the same cavity at Re 80",
        "grid-flow",
        CAVITY_100,
        -0.2140417,
        partial(grid_flow.cavity, 80, (64, 12)),
        relative=0.01,
        control=True,
    ),
    Case(
        "lid-driven cavity, Re 1000, 256^2 cells: least velocity",
        "grid-flow",
        "Botella, Peyret 1998, Comput. Fluids 27",
        -0.3885698,
        partial(grid_flow.cavity, 1000, (64, 50), (128, 35), (256, 10)),
        relative=0.01,
        quick=False,
    ),
    *(
        Case(
            f"natural convection of air, Ra {rayleigh:g}: Nusselt number",
            "grid-flow",
            "de Vahl Davis 1983, and later spectral values",
            figure,
            partial(grid_flow.nusselt, rayleigh, n, duration),
            relative=0.02,
            quick=rayleigh < 1e5,
        )
        for rayleigh, figure, n, duration in (
            (1e3, 1.1178, 24, 0.5),
            (1e4, 2.2448, 40, 0.4),
            (1e5, 4.5216, 64, 0.25),
        )
    ),
    Case(
        "flow between plates: largest velocity over the mean",
        "grid-flow",
        "Poiseuille",
        1.5,
        grid_flow.plates,
        absolute=0.02,
    ),
    Case(
        "velocity 0.15 m above a plate that set off 2 s ago",
        "grid-flow",
        "Stokes 1851: erfc(y / 2 sqrt(nu t))",
        math.erfc(0.15 / 2 / math.sqrt(0.02)),
        partial(grid_flow.stokes_plate, 32),
        relative=0.01,
        unit="m/s",
    ),
    Case(
        "the same with twice the viscosity",
        "grid-flow",
        "Stokes 1851: erfc(y / 2 sqrt(nu t))",
        math.erfc(0.15 / 2 / math.sqrt(0.02)),
        partial(grid_flow.stokes_plate, 32, 0.02),
        relative=0.01,
        unit="m/s",
        control=True,
    ),
    Case(
        "rate at which the energy of an eddy decays",
        "grid-flow",
        "Taylor, Green 1937: 4 nu k^2",
        4 * 0.01 * math.pi**2,
        partial(grid_flow.eddy_decay, 32),
        relative=0.01,
        unit="1/s",
    ),
    Case(
        "critical Rayleigh number between plates, 16 cells",
        "grid-flow",
        "Chandrasekhar 1961: 1707.8",
        1707.8,
        partial(grid_flow.critical_rayleigh, 16),
        relative=0.025,
    ),
    Case(
        "speed of the light fluid out of a lock, ratio 2",
        "grid-flow",
        "Benjamin 1968, J. Fluid Mech. 31: 1/2 sqrt((1 - 1 / ratio) g H)",
        0.5,
        partial(grid_flow.lock, 2.0, 32),
        absolute=0.04,
    ),
    Case(
        "drag of a cylinder in a channel, Re 20",
        "grid-flow",
        "Schaefer, Turek 1996, 2D-1; FeatFlow, finest",
        5.57953523,
        partial(grid_flow.drag, 41),
        relative=0.01,
        quick=False,
    ),
    Case(
        "Strouhal number of a cylinder in a channel, Re 100",
        "grid-flow",
        "Schaefer, Turek 1996, 2D-2; FeatFlow, finest",
        0.30188,
        partial(grid_flow.strouhal, 62),
        relative=0.02,
        quick=False,
    ),
)

GRID_LIQUID = (
    Case(
        "pressure 0.25 m below still water",
        "grid-liquid",
        "rho g z",
        1000 * G * 0.25,
        grid_liquid.pressure,
        relative=1e-3,
        unit="Pa",
    ),
    *(
        Case(
            f"period of sloshing, {depth} m deep, {n} cells to 1 m",
            "grid-liquid",
            SLOSHING,
            2 * math.pi / _omega(depth),
            partial(grid_liquid.sloshing_period, n, depth),
            relative=5e-3,
            unit="s",
        )
        for depth, n in ((0.25, 64), (0.5, 64))
    ),
    Case(
        "sloshing with gravity that is 5 % too weak",
        "grid-liquid",
        SLOSHING,
        2 * math.pi / _omega(0.5),
        partial(grid_liquid.sloshing_period, 64, 0.5, 0.95 * G),
        relative=5e-3,
        unit="s",
        control=True,
    ),
    *(
        Case(
            f"largest error of the front of a dam break, {n} cells to its width",
            "grid-liquid",
            MARTIN_MOYCE,
            0.0,
            partial(grid_liquid.dam_break, n),
            absolute=0.03,
            quick=n < 30,
        )
        for n in (24, 48)
    ),
    Case(
        "surface speed of a viscous film on 30 degrees",
        "grid-liquid",
        "Nusselt: g sin a h^2 / (2 nu)",
        0.5 * G * 0.1**2 / 2 / 0.1,
        partial(grid_liquid.film, 10),
        relative=0.01,
        unit="m/s",
    ),
    *(
        Case(
            f"pressure in a drop times radius over tension, {dimension} dimensions",
            "grid-liquid",
            "Laplace: d - 1",
            dimension - 1.0,
            partial(grid_liquid.laplace, dimension, cells),
            relative=0.02,
        )
        for dimension, cells in ((2, 16), (3, 8))
    ),
    Case(
        "frequency of capillary waves",
        "grid-liquid",
        "Lamb, Hydrodynamics, art. 266: w^2 = sigma k^3 tanh(k h) / rho",
        math.sqrt(math.pi**3 * math.tanh(math.pi / 2)),
        partial(grid_liquid.capillary_wave, 32),
        relative=0.03,
        unit="1/s",
    ),
    Case(
        "the same waves with half the tension",
        "grid-liquid",
        "Lamb, Hydrodynamics, art. 266: w^2 = sigma k^3 tanh(k h) / rho",
        math.sqrt(math.pi**3 * math.tanh(math.pi / 2)),
        partial(grid_liquid.capillary_wave, 32, 0.5),
        relative=0.03,
        unit="1/s",
        control=True,
    ),
    Case(
        "lift of a ball under water over what it displaces",
        "grid-liquid",
        "Archimedes",
        1.0,
        partial(grid_liquid.lift, 32),
        relative=0.012,
    ),
)

MPM = (
    *(
        Case(
            f"period of a bar, {cells} cells, {kernel} kernel",
            "mpm",
            "4 L sqrt(rho / E)",
            10.0,
            partial(mpm.bar_period, cells, kernel),
            relative=band,
            unit="s",
        )
        for cells, kernel, band in (
            (13, "quadratic", 0.02),
            (26, "quadratic", 0.01),
            (13, "linear", 0.005),
        )
    ),
    Case(
        "the same bar with 10 % more stiffness",
        "mpm",
        "4 L sqrt(rho / E)",
        10.0,
        partial(mpm.bar_period, 26, "quadratic", 110.0),
        relative=0.01,
        unit="s",
        control=True,
    ),
    Case(
        "friction of a layer of sand, 30 degrees",
        "mpm",
        "plane strain: tan = sin phi",
        math.degrees(math.atan(0.5)),
        partial(mpm.slope_angle, 30),
        absolute=0.3,
        unit="degrees",
    ),
    Case(
        "depth of a pool at rest over that of its volume",
        "mpm",
        "conserved",
        1.0,
        mpm.pool_depth,
        relative=0.01,
    ),
    Case(
        "load of the floor below a jelly over its weight",
        "mpm",
        "closed form",
        1.0,
        mpm.floor_load,
        relative=1e-3,
    ),
    Case(
        "run-out of a column of sand as high as its half width",
        "mpm",
        "between Lube et al. 2005 (1.2) and Lajeunesse et al. 2005 (1.8)",
        1.5,
        partial(mpm.run_out, 1.0, 16),
        absolute=0.3 + 0.15 * 1.5,
    ),
    Case(
        "the same, 32 cells to the half width",
        "mpm",
        "between Lube et al. 2005 (1.2) and Lajeunesse et al. 2005 (1.8)",
        1.5,
        partial(mpm.run_out, 1.0, 32),
        absolute=0.3 + 0.15 * 1.5,
        quick=False,
    ),
    Case(
        "the same without friction between grains",
        "mpm",
        "between Lube et al. 2005 (1.2) and Lajeunesse et al. 2005 (1.8)",
        1.5,
        partial(mpm.run_out, 1.0, 16, 0.0),
        absolute=0.3 + 0.15 * 1.5,
        control=True,
    ),
)

COUPLING = (
    *(
        Case(
            f"depth of a floating ball, {ratio} of the density of water, {n} cells",
            "coupling",
            "Archimedes: d^2 (3 - 2 d) = ratio",
            figure,
            partial(coupling.draft, figure, ratio, n),
            absolute=0.02,
            unit="m",
            quick=n <= 12,
        )
        for ratio, figure, n in ((0.5, 0.5, 12), (0.9, 0.8042, 12), (0.1, 0.1958, 16))
    ),
    Case(
        "depth of a ball that is said to weigh 0.9, but weighs 0.7",
        "coupling",
        "Archimedes: d^2 (3 - 2 d) = ratio",
        0.8042,
        partial(coupling.draft, 0.8042, 0.7, 12),
        absolute=0.02,
        unit="m",
        control=True,
    ),
    Case(
        "acceleration of a ball released under water, half as dense, over g",
        "coupling",
        "Lamb, Hydrodynamics, art. 92: added mass of a half",
        0.5,
        partial(coupling.added_mass, 0.5),
        relative=0.1,
    ),
    *(
        Case(
            f"depth of a raft in a liquid of particles, {ratio} of its density",
            "coupling",
            "Archimedes",
            ratio,
            partial(coupling.raft, ratio),
            absolute=0.02,
        )
        for ratio in (0.3, 0.5)
    ),
    Case(
        "sag of two springs under a ball",
        "coupling",
        "2 k (l - r) w / l = m g, l^2 = 1 + w^2",
        coupling.sag_of_two_springs(),
        coupling.ball_on_springs,
        relative=1e-3,
        unit="m",
    ),
    Case(
        "momentum of a ball and of the jelly that it hits",
        "coupling",
        "conserved",
        0.0,
        coupling.momentum_lost,
        absolute=1e-10,
        unit="kg m/s",
    ),
    Case(
        "thrust of sand at rest on a wall",
        "coupling",
        "elastic: nu / (1 - nu)",
        0.3 / 0.7,
        partial(coupling.pressure_at_rest, 33, 0.3),
        relative=0.01,
    ),
)

CASES: tuple[Case, ...] = (
    *ODE,
    *FIELDS,
    *SPRINGS,
    *SOFT_BODY,
    *PBD,
    *PBF,
    *RIGID,
    *GRID_FLOW,
    *GRID_LIQUID,
    *MPM,
    *COUPLING,
)
METHODS = tuple(dict.fromkeys(case.method for case in CASES))


def cases(method: str | None = None, *, quick: bool = False) -> tuple[Case, ...]:
    """Return the cases that there are.

    Parameters
    ----------
    method : str, optional
        Those of one method: `ode`, `fields`, `springs`, `soft-body`, `pbd`, `pbf`, `rigid`,
        `grid-flow`, `grid-liquid`, `mpm` or `coupling`.
    quick : bool
        Only those that take seconds.

    Returns
    -------
    tuple of Case
        In the order of the list.

    Raises
    ------
    InputError
        If there is no such method.

    Examples
    --------
    >>> import substep
    >>> len(substep.validate.cases()) >= 40
    True
    """
    if method is not None:
        method = check_choice("method", method, METHODS)
    return tuple(
        case for case in CASES if method in (None, case.method) and (case.quick or not quick)
    )
