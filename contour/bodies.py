"""From the bodies of a scene file to one environment."""

from __future__ import annotations

import numpy as np
import trimesh

from contour.mesh_env import MeshEnvironment
from contour.mesh_io import load_scene
from contour.scene import Body

__all__ = ["build_environment"]


def build_environment(bodies: tuple[Body, ...]) -> MeshEnvironment:
    """All ``bodies`` in the world, each with its friction; a file with several geometries gives several
    bodies.
    """
    together = trimesh.Scene()
    friction: list[float] = []
    for number, body in enumerate(bodies):
        part = load_scene(body.mesh, unit=body.unit, transform=body.placement)
        for node in part.graph.nodes_geometry:
            pose, key = part.graph[node]
            geometry = part.geometry[key]
            if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
                together.add_geometry(
                    geometry, node_name=f"{number}:{node}", geom_name=f"{number}:{key}", transform=pose
                )
                friction.append(float(np.tan(body.friction_angle)))
    return MeshEnvironment(together, friction=friction)
