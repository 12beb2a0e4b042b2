"""What of a simulation is recorded and drawn, unless its scene says otherwise."""

from __future__ import annotations

from typing import Any

from .parts import Part


def particle_parts(simulation: Any) -> dict[str, Part]:
    """One part of all fields that the simulation offers: `particles`, or the cells of a `grid`.

    Cloth, nets and soft bodies are meshes, and what has a `skin` is that. Of a `World` one for each
    member, under its name.
    """
    from .topology import shapes_of, topology_of  # loads the methods

    parts = {}
    for name, member, columns in _blocks(simulation):
        units = {key: unit for key, (_, unit) in columns.items() if key != "position"}
        skin = getattr(member, "skin", None)
        if skin is not None:
            parts[name or "particles"] = Part("mesh", units, triangles=skin.faces)
        elif "position" in columns:
            topology = topology_of(member)
            kind = "bodies" if "orientation" in units else "mesh" if topology else "particles"
            shapes = shapes_of(member) if kind == "bodies" else {}
            parts[name or "particles"] = Part(kind, units, **topology, **shapes)
        else:
            parts[name or "grid"] = Part("grid", units, bounds=member.bounds, cell=member.cell)
    return parts


def particle_frame(simulation: Any) -> dict[str, dict[str, Any]]:
    """One frame of `particle_parts(simulation)`."""
    frame = {}
    for name, _, units in _blocks(simulation):
        columns = {key: values for key, (values, _) in units.items()}
        if "position" in columns:
            frame[name or "particles"] = {"points": columns.pop("position"), **columns}
        else:
            frame[name or "grid"] = columns
    return frame


def _blocks(simulation: Any) -> list[tuple[str, Any, dict[str, tuple[Any, str]]]]:
    """Name, simulation and fields of each member of a world, or of the one simulation."""
    members = getattr(simulation, "members", {"": simulation})
    return [(name, member, _columns(member)) for name, member in members.items()]


def _columns(simulation: Any) -> dict[str, tuple[Any, str]]:
    fields = simulation.fields()
    if (skin := getattr(simulation, "skin", None)) is not None:
        fields = {key: (skin(fields[key][0]), fields[key][1]) for key in ("position", "velocity")}
    return {name: (values, unit or "1") for name, (values, unit) in fields.items()}
