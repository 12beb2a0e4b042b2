"""What a triangle mesh lacks."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MeshReport:
    """What a triangle mesh is and lacks; `str` says it in plain words.

    Attributes
    ----------
    vertices, faces : int
        Numbers.
    components : int
        Connected parts, by shared edges.
    area, volume : float
        Area [m^2]; volume [m^3], which means something for closed meshes.
    boundary_edges, holes : int
        Edges with one face, and the loops they form.
    non_manifold_edges : int
        Edges with more than two faces.
    flipped_edges : int
        Edges whose two faces look to different sides.
    duplicate_faces : int
        Faces that have the corners of another one.
    flat_faces : int
        Faces without area (height below 1e-10 of the longest edge).
    duplicate_vertices : int
        Vertices at the place of another one.
    unused_vertices : int
        Vertices of no face.
    pierced : int
        Edges that pass through a face: the surface cuts itself.
    dropped_faces : int
        Faces that were left out when the mesh was read or cleaned.
    """

    vertices: int
    faces: int
    components: int
    area: float
    volume: float
    boundary_edges: int
    holes: int
    non_manifold_edges: int
    flipped_edges: int
    duplicate_faces: int
    flat_faces: int
    duplicate_vertices: int
    unused_vertices: int
    pierced: int
    dropped_faces: int

    @property
    def closed(self) -> bool:
        """Every edge has two faces, which look to the same side: the mesh bounds a solid."""
        return not (self.boundary_edges or self.non_manifold_edges or self.flipped_edges)

    @property
    def lacks(self) -> list[str]:
        """Each defect as a phrase; empty for a mesh without any."""
        named = [
            (self.boundary_edges, f"open: {self.boundary_edges} border edges, {self.holes} holes"),
            (self.non_manifold_edges, f"{self.non_manifold_edges} edges with more than two faces"),
            (self.flipped_edges, f"{self.flipped_edges} edges whose faces look to different sides"),
            (self.closed and self.volume < 0, "inside out"),
            (self.duplicate_faces, f"{self.duplicate_faces} duplicated faces"),
            (self.flat_faces, f"{self.flat_faces} faces without area"),
            (self.duplicate_vertices, f"{self.duplicate_vertices} duplicated vertices"),
            (self.unused_vertices, f"{self.unused_vertices} unused vertices"),
            (self.pierced, f"cuts itself: {self.pierced} edges pass through a face"),
            (self.dropped_faces, f"{self.dropped_faces} faces were left out"),
        ]
        return [phrase for count, phrase in named if count]

    def __str__(self) -> str:
        head = f"{self.vertices} vertices, {self.faces} faces, {self.components} components"
        return "\n".join([head, *(self.lacks or ["closed, manifold, oriented"])])
