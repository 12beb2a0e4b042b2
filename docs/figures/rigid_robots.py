"""Draws docs/figures/rigid_robots.png: python docs/figures/rigid_robots.py.

Needs `pip install gymnasium pybullet`, whose files are shown.
"""

import importlib.util
import io
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LightSource
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from PIL import Image
from substep import RigidBodies, rigid
from substep.base.quaternions import rotate

FOLDER = Path(__file__).resolve().parent
COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")


def packaged(package, *path):
    """A file of an installed package."""
    return Path(importlib.util.find_spec(package).submodule_search_locations[0], *path)


def drive(robot, pose, **motor):
    for name, target in pose.items():
        robot.joint(name).motor = rigid.SpringMotor(target, **motor)
    robot.advance(3.0)
    return robot


def ant():
    pose = {f"ankle_{k}": sign * 0.9 for k, sign in ((1, 1), (2, -1), (3, -1), (4, 1))}
    path = packaged("gymnasium", "envs", "mujoco", "assets", "ant.xml")
    robot = RigidBodies.from_mjcf(path, coordinates=pose)
    return drive(robot, pose | {f"hip_{k}": 0.0 for k in (1, 2, 3, 4)}, stiffness=60, damping=2)


def dog():
    feet = {"hip": 0.0, "upper": 0.8, "lower": -1.6}
    pose = {f"{leg}_{k}_joint": q for leg in ("FR", "FL", "RR", "RL") for k, q in feet.items()}
    path = packaged("pybullet_data", "a1", "a1.urdf")
    robot = RigidBodies.from_urdf(path, free_base=True, coordinates=pose)
    robot.set_positions(robot.positions + np.array((0, 0, 0.4)))
    robot.add(rigid.Plane(), (0, 0, 0), motion="static", friction=1.0)
    return drive(robot, pose, stiffness=120, damping=4, strength=33)


def arm():
    robot = RigidBodies.from_urdf(packaged("pybullet_data", "kuka_iiwa", "model.urdf"))
    pose = dict(zip(robot.joint_names, (0.3, 0.6, -0.2, -1.2, 0.4, 0.7, 0.1), strict=True))
    return drive(robot, pose, stiffness=2000, damping=150, strength=300)


def draw(axes, robot, title):
    points = []
    for body in robot.ids:
        for fixture in robot.fixtures(body):
            if isinstance(fixture.shape, rigid.Plane):
                continue
            mesh = fixture.shape.mesh()
            x = robot.positions[body] + rotate(robot.rotations[body], mesh.vertices)
            points.append(x)
            axes.add_collection3d(
                Poly3DCollection(
                    x[mesh.faces],
                    facecolors=COLOURS[body % len(COLOURS)],
                    shade=True,
                    lightsource=LightSource(225, 50),
                )
            )
    low, high = np.concatenate(points).min(axis=0), np.concatenate(points).max(axis=0)
    middle, half = (low + high) / 2, (high - low).max() / 2
    axes.set(
        xlim=middle[0] + np.array((-half, half)),
        ylim=middle[1] + np.array((-half, half)),
        zlim=low[2] + np.array((0, 2 * half)),
    )
    axes.set_box_aspect((1, 1, 1), zoom=1.1)
    axes.view_init(20, -60)
    axes.set_axis_off()
    axes.set_title(title, y=0.95)


def main():
    figure = plt.figure(figsize=(10, 3.6), layout="constrained")
    robots = ((ant(), "ant (MJCF)"), (dog(), "A1 (URDF)"), (arm(), "iiwa (URDF)"))
    for k, (robot, title) in enumerate(robots):
        draw(figure.add_subplot(1, 3, k + 1, projection="3d"), robot, title)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    image = Image.open(buffer).convert("RGB").quantize(64)
    image.save(FOLDER / "rigid_robots.png", optimize=True)


if __name__ == "__main__":
    main()
