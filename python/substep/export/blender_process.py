"""Blender as a program of its own: `blender_process.py TASK.json` does what the task says.

It needs bpy, Blender as a module, and NumPy; it opens a USD stage whose time code k is frame k, or
arrays, and writes Alembic, OpenVDB or images.
"""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from typing import Any


def main(path: str) -> None:
    """Do the task of a file."""
    task = json.loads(Path(path).read_text(encoding="utf-8"))
    {"alembic": write_alembic, "volumes": write_volumes, "images": write_images}[task["do"]](task)


def open_stage(task: dict[str, Any]) -> Any:
    """An empty scene with all that the stage holds; returns it."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    if task.get("usd"):
        bpy.ops.wm.usd_import(filepath=task["usd"], set_frame_range=True)
    if rate := task.get("rate"):
        scene.render.fps = max(1, round(rate))
        scene.render.fps_base = scene.render.fps / rate
    return scene


def part_of(thing: Any) -> str:
    """Name of the part that an object belongs to: the one below the root."""
    while thing.parent is not None and thing.parent.parent is not None:
        thing = thing.parent
    return str(thing.name)


def write_alembic(task: dict[str, Any]) -> None:
    """The whole stage; clouds of points become vertices, which Alembic's exporter knows."""
    import bpy

    scene = open_stage(task)
    for cloud in [thing for thing in bpy.data.objects if thing.type == "POINTCLOUD"]:
        mesh = bpy.data.objects.new("vertices", bpy.data.meshes.new("vertices"))
        scene.collection.objects.link(mesh)
        mesh.parent, name = cloud.parent, cloud.name
        tree = bpy.data.node_groups.new("vertices", "GeometryNodeTree")
        tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
        source = tree.nodes.new("GeometryNodeObjectInfo")
        source.inputs["Object"].default_value = cloud
        turned = tree.nodes.new("GeometryNodePointsToVertices")
        end = tree.nodes.new("NodeGroupOutput")
        tree.links.new(source.outputs["Geometry"], turned.inputs["Points"])
        tree.links.new(turned.outputs["Mesh"], end.inputs[0])
        mesh.modifiers.new("vertices", "NODES").node_group = tree
        if name in task["widths"]:
            mesh["width"] = task["widths"][name]
        cloud.name = f"{name}__cloud"
        mesh.name = mesh.data.name = name
        cloud.select_set(False)
        mesh.select_set(True)
    for thing in bpy.data.objects:
        thing.select_set(not thing.name.endswith("__cloud"))
    bpy.ops.wm.alembic_export(
        filepath=task["out"],
        start=scene.frame_start,
        end=scene.frame_end,
        selected=True,
        as_background_job=False,
    )


def write_volumes(task: dict[str, Any]) -> None:
    """Grids of one frame and part in a file each, cells of 0 left out."""
    import bpy
    import numpy as np

    sys.path.append(
        str(
            Path(bpy.utils.resource_path("LOCAL"))
            / f"python/lib/python3.{sys.version_info[1]}/site-packages"
        )
    )
    import openvdb

    for file in task["files"]:
        grids = []
        with np.load(file["arrays"], allow_pickle=False) as arrays:
            for name in arrays.files:
                values = np.ascontiguousarray(arrays[name], np.float32)
                grid = openvdb.Vec3SGrid() if values.ndim == 4 else openvdb.FloatGrid()
                grid.copyFromArray(values)
                grid.name = name
                grid.transform = openvdb.createLinearTransform(voxelSize=file["cell"])
                grid.transform.postTranslate(file["origin"])
                grids.append(grid)
        openvdb.write(file["out"], grids=grids)


def write_images(task: dict[str, Any]) -> None:
    """Path-traced images of some frames."""
    import bpy

    scene = open_stage(task)
    dress(task)
    add_ground(scene, task)
    add_volumes(scene, task)
    for light in task["lights"]:
        data = bpy.data.lights.new("sun", "SUN")
        data.energy, data.color = light["strength"], light["color"]
        data.angle = 0.15
        add(scene, "sun", data).rotation_euler = light["rotation"]
    world = bpy.data.worlds.new("sky")
    scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    sky = nodes["Background"].inputs
    sky["Color"].default_value = (*task["sky"], 1)
    rays, strength = nodes.new("ShaderNodeLightPath"), nodes.new("ShaderNodeMapRange")
    strength.inputs["To Min"].default_value = task["sky_strength"]  # of what is lit by it
    strength.inputs["To Max"].default_value = 1  # of what is seen of it
    links.new(rays.outputs["Is Camera Ray"], strength.inputs["Value"])
    links.new(strength.outputs["Result"], sky["Strength"])
    camera = add(scene, "camera", bpy.data.cameras.new("camera"))
    camera.data.sensor_fit = "VERTICAL"
    camera.data.clip_start, camera.data.clip_end = 1e-3, 1e5
    camera.rotation_mode = "QUATERNION"
    scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.cycles.samples = task["samples"]
    scene.cycles.seed = 0
    scene.cycles.use_denoising = task["denoise"]
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.max_bounces = 8
    scene.render.resolution_x, scene.render.resolution_y = task["size"]
    scene.render.resolution_percentage = 100
    scene.render.use_persistent_data = True
    scene.render.image_settings.file_format = "PNG"
    scene.view_settings.view_transform = "Standard"
    scene.render.threads_mode = "AUTO"
    for shot in task["shots"]:
        scene.frame_set(shot["frame"])
        camera.location, camera.rotation_quaternion = shot["position"], shot["rotation"]
        camera.data.angle_y = shot["angle"]
        show_volumes(task, shot["frame"])
        scene.render.filepath = shot["out"]
        bpy.ops.render.render(write_still=True)
        print("done", shot["frame"], flush=True)


def add(scene: Any, name: str, data: Any) -> Any:
    """An object of data."""
    import bpy

    made = bpy.data.objects.new(name, data)
    scene.collection.objects.link(made)
    return made


def dress(task: dict[str, Any]) -> None:
    """Give every object the material of its part; hide what is not to be seen."""
    import bpy

    made: dict[tuple[str, int], Any] = {}
    for thing in bpy.data.objects:
        name = part_of(thing)
        look = task["looks"].get(name)
        if look is None or thing.type == "EMPTY":
            continue
        if look["hidden"]:
            thing.hide_render = True
            continue
        body = re.match(r"body_(\d+)", thing.name)
        k = int(body.group(1)) % len(look["colors"]) if body else 0
        if (name, k) not in made:
            made[name, k] = material(name, look, look["colors"][k])
        thing.data.materials.clear()
        thing.data.materials.append(made[name, k])
        # What the cache brings has materials of its own, numbered before ours.
        tree = bpy.data.node_groups.new("dress", "GeometryNodeTree")
        for way in ("INPUT", "OUTPUT"):
            tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
        begin, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
        last = begin.outputs[0]
        if thing.type == "MESH":
            last = smoothed(tree, last, look["crease"])
        dressed = tree.nodes.new("GeometryNodeSetMaterial")
        dressed.inputs["Material"].default_value = made[name, k]
        tree.links.new(last, dressed.inputs["Geometry"])
        tree.links.new(dressed.outputs["Geometry"], end.inputs[0])
        thing.modifiers.new("dress", "NODES").node_group = tree


def smoothed(tree: Any, last: Any, crease: float) -> Any:
    """Smooth faces, but for the edges of more than an angle."""
    smooth = tree.nodes.new("GeometryNodeSetShadeSmooth")
    tree.links.new(last, smooth.inputs["Mesh"])
    angle, sharp = (
        tree.nodes.new("GeometryNodeInputMeshEdgeAngle"),
        tree.nodes.new("ShaderNodeMath"),
    )
    sharp.operation = "GREATER_THAN"
    sharp.inputs[1].default_value = crease
    tree.links.new(angle.outputs["Unsigned Angle"], sharp.inputs[0])
    edges = tree.nodes.new("GeometryNodeSetShadeSmooth")
    edges.domain = "EDGE"
    edges.inputs["Shade Smooth"].default_value = False
    tree.links.new(sharp.outputs[0], edges.inputs["Selection"])
    tree.links.new(smooth.outputs[0], edges.inputs["Mesh"])
    return edges.outputs[0]


def material(name: str, look: dict[str, Any], color: list[float]) -> Any:
    """A surface of a look; water is clear, and takes its colour from the way through it."""
    import bpy

    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    surface = nodes["Principled BSDF"]
    surface.inputs["Base Color"].default_value = (*color, 1)
    surface.inputs["Roughness"].default_value = look["roughness"]
    surface.inputs["Metallic"].default_value = look["metallic"]
    surface.inputs["Alpha"].default_value = look["opacity"]
    if look["liquid"]:
        surface.inputs["Base Color"].default_value = (1, 1, 1, 1)
        surface.inputs["Roughness"].default_value = 0.02
        surface.inputs["Transmission Weight"].default_value = 1
        surface.inputs["IOR"].default_value = 1.333
        inside = nodes.new("ShaderNodeVolumeAbsorption")
        inside.inputs["Color"].default_value = (*(c**0.5 for c in color), 1)
        inside.inputs["Density"].default_value = look["absorption"]
        links.new(inside.outputs[0], nodes["Material Output"].inputs["Volume"])
    if field := look["field"]:
        value = nodes.new("ShaderNodeAttribute")
        value.attribute_name = field["name"]
        last = value.outputs["Fac"]
        if field["vector"]:
            norm = nodes.new("ShaderNodeVectorMath")
            norm.operation = "LENGTH"
            links.new(value.outputs["Vector"], norm.inputs[0])
            last = norm.outputs["Value"]
        scaled = nodes.new("ShaderNodeMapRange")
        scaled.inputs["From Min"].default_value, scaled.inputs["From Max"].default_value = field[
            "range"
        ]
        links.new(last, scaled.inputs["Value"])
        ramp = nodes.new("ShaderNodeValToRGB")
        stops = ramp.color_ramp.elements
        colors = field["colors"]
        while len(stops) < len(colors):
            stops.new(1.0)
        for k, stop in enumerate(stops):
            stop.position, stop.color = k / (len(colors) - 1), (*colors[k], 1)
        links.new(scaled.outputs["Result"], ramp.inputs["Fac"])
        links.new(ramp.outputs["Color"], surface.inputs["Base Color"])
    return made


def add_ground(scene: Any, task: dict[str, Any]) -> None:
    """A wide square."""
    import bpy

    ground = task["ground"]
    if ground is None:
        return
    (x, y, z), half = ground["center"], ground["half"]
    mesh = bpy.data.meshes.new("ground")
    corners = [(x + a * half, y + b * half, z) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    look = {"roughness": 0.9, "metallic": 0.0, "opacity": 1.0, "liquid": False, "field": None}
    mesh.materials.append(material("ground", look, ground["color"]))
    add(scene, "ground", mesh)


def add_volumes(scene: Any, task: dict[str, Any]) -> None:
    """Smoke: a volume for each frame, of which one is seen."""
    import bpy

    for name, volume in task["volumes"].items():
        made = bpy.data.materials.new(name)
        made.use_nodes = True
        nodes = made.node_tree.nodes
        nodes.clear()
        smoke, end = nodes.new("ShaderNodeVolumePrincipled"), nodes.new("ShaderNodeOutputMaterial")
        smoke.inputs["Color"].default_value = (*volume["color"], 1)
        smoke.inputs["Density"].default_value = volume["density"]
        smoke.inputs["Density Attribute"].default_value = volume["field"]
        made.node_tree.links.new(smoke.outputs[0], end.inputs["Volume"])
        for frame, path in volume["files"].items():
            data = bpy.data.volumes.new(f"{name}__{frame}")
            data.filepath = path
            data.materials.append(made)
            add(scene, f"{name}__{frame}", data)


def show_volumes(task: dict[str, Any], frame: int) -> None:
    """Those of a frame, and no others."""
    import bpy

    for name, volume in task["volumes"].items():
        for other in volume["files"]:
            bpy.data.objects[f"{name}__{other}"].hide_render = other != str(frame)


if __name__ == "__main__":
    code = 0
    try:
        main(sys.argv[1])
    except Exception as error:
        print(f"failed: {type(error).__name__}: {error}", file=sys.stderr)
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # without what Blender says of its memory at the end
