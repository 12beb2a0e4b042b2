"""Where the bodies of bench/rigid.py lie, for all engines; needs NumPy only.

The scenes with a peer of the same name are those of rigid_scenes.py. A body is (kind, size,
position, rotation (w, x, y, z), mass); sizes are half lengths, a radius, or a radius and the half
length of a capsule. Walls are static boxes: (half lengths, position).
"""

import math

import numpy as np

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
BOX = (0.5, 0.5, 0.5)
KINDS = {"box": (0.1, 0.1, 0.1), "sphere": (0.1,), "capsule": (0.07, 0.08)}


def stack(count, masses=None):
    return [
        ("box", BOX, (0, 0, 0.5 + k), UPRIGHT, 1.0 if masses is None else masses[k])
        for k in range(count)
    ]


def pyramid(rows):
    return [
        ("box", BOX, ((c - (rows - r - 1) / 2) * 1.05, 0, 0.5 + r), UPRIGHT, 1.0)
        for r in range(rows)
        for c in range(rows - r)
    ]


def pile(count, kinds, seed=1):
    """Ten layers of bodies at any angle, above the floor of a bin; and its walls."""
    rng = np.random.default_rng(seed)
    side = math.ceil(math.sqrt(count / 10))
    bodies, middle = [], (side - 1) / 2
    for k in range(count):
        column, row, layer = k % side, k // side % side, k // side**2
        x = (column - middle) * 0.26 + rng.uniform(-0.02, 0.02)
        y = (row - middle) * 0.26 + rng.uniform(-0.02, 0.02)
        q = rng.normal(size=4)
        q = q[[3, 0, 1, 2]] / np.linalg.norm(q)
        kind = kinds[k % len(kinds)]
        bodies.append((kind, KINDS[kind], (x, y, 0.3 + layer * 0.27), tuple(q), 1.0))
    half = side * 0.13 + 0.3
    walls = [
        (((half, 0.2, 2) if along else (0.2, half, 2)), ((0, s, 2) if along else (s, 0, 2)))
        for along in (True, False)
        for s in (half, -half)
    ]
    return bodies, walls


def dominoes(count=30):
    """A row 0.5 m apart; the first leans by 0.3 rad on its foot's edge."""
    a = 0.3
    x = 0.05 * math.cos(a) + 0.5 * math.sin(a) - 0.05
    z = 0.5 * math.cos(a) + 0.05 * math.sin(a)
    first = ((x, 0, z), (math.cos(a / 2), 0, math.sin(a / 2), 0))
    places = [first] + [((0.5 * k, 0, 0.5), UPRIGHT) for k in range(1, count)]
    return [("box", (0.05, 0.25, 0.5), at, q, 1.0) for at, q in places]
