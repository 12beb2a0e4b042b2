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


def doll(at=(0.0, 0.0, 0.0)):
    """A ragdoll of 15 capsules and 14 joints that stands: (parent, joint, anchor, axis, ends, ...).

    The last two are radius and mass; the parent of the first is None, and -1 the world.
    """
    parts = []

    def add(parent, joint, anchor, axis, first, last, radius, mass):
        ends = np.add(at, [first, last])
        parts.append((parent, joint, np.add(at, anchor), axis, ends, radius, mass))
        return len(parts) - 1

    y, z = (0, 1, 0), (0, 0, 1)
    pelvis = add(None, None, (0, 0, 1), y, (0, -0.08, 1), (0, 0.08, 1), 0.1, 10)
    spine = add(pelvis, "ball", (0, 0, 1.12), y, (0, 0, 1.16), (0, 0, 1.24), 0.1, 8)
    chest = add(spine, "ball", (0, 0, 1.33), y, (0, -0.08, 1.42), (0, 0.08, 1.42), 0.11, 12)
    head = add(chest, "ball", (0, 0, 1.57), y, (0, 0, 1.66), (0, 0, 1.72), 0.09, 5)
    add(head, "hinge", (0, 0, 1.82), y, (0, 0, 1.86), (0, 0, 1.88), 0.03, 0.3)
    for s in (1, -1):
        x = 0.1 * s
        thigh = add(pelvis, "ball", (0, x, 0.92), y, (0, x, 0.84), (0, x, 0.56), 0.06, 7)
        shin = add(thigh, "hinge", (0, x, 0.5), y, (0, x, 0.43), (0, x, 0.17), 0.05, 4)
        add(shin, "hinge", (0, x, 0.09), y, (0, x, 0.05), (0.12, x, 0.05), 0.04, 1)
        x, near, far = 0.2 * s, (0.26 * s, 0.46 * s), (0.57 * s, 0.75 * s)
        upper, lower = ([(0, end, 1.45) for end in ends] for ends in (near, far))
        arm = add(chest, "ball", (0, x, 1.45), y, *upper, 0.045, 2.5)
        add(arm, "hinge", (0, 0.52 * s, 1.45), z, *lower, 0.04, 1.5)
    return parts


def hinges(count):
    """A chain of links of 0.1 m and 0.1 kg, level, that hangs from the world by its first."""
    links = []
    for k in range(count):
        ends = np.array([(0.1 * k + d, 0, 0) for d in (0.01, 0.09)])
        links.append((k - 1, "hinge", (0.1 * k, 0, 0), (0, 1, 0), ends, 0.01, 0.1))
    return links


# Small worlds: boxes, trees of joints, and whether there is a floor; without one nothing touches.
SMALL = {
    "2 boxes": ([("box", BOX, (2 * k, 0, 0.5), UPRIGHT, 1.0) for k in range(2)], [], True),
    "stack 10": (stack(10), [], True),
    "ragdoll": ([], [doll((0, 0, 0.05))], True),
    "hinges 100": ([], [hinges(100)], False),
    "ragdolls 100": ([], [doll((2.0 * (k % 10), 2.5 * (k // 10), 0.05)) for k in range(100)], True),
}


def turn_to(d):
    """The quaternion (w, x, y, z) that turns the z axis to a direction."""
    x, y, z = d / np.linalg.norm(d)
    q = np.array([1 + z, -y, x, 0.0]) if z > -0.999 else np.array([0, 1.0, 0, 0])
    return q / np.linalg.norm(q)
