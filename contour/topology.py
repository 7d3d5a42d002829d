"""What meets what in a mesh: welded vertices, edges with their dihedral angles, sharp ones, smooth patches.

Nothing is assumed of the mesh: it may be open, wound both ways, or have edges with more than two faces. Faces
are turned to agree with their neighbours where that is possible; which side is outside is never asked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

__all__ = ["Topology", "build_topology"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

WELD = 1e-8
"""Vertices closer than this share of the mesh's extent are the same."""
SHARP = np.deg2rad(60.0)
"""An edge that turns more than this is sharp wherever it is [rad]."""
SHARP_AMONG_FLAT = np.deg2rad(30.0)
"""An edge that turns more than this is sharp where the edges around it turn much less [rad]."""
MUCH_LESS = 3.0
"""By this factor: a fixed angle alone would call every edge of a coarse cylinder sharp."""
_KEY = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0x27D4EB2F165667C5], np.uint64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Topology:
    """Edges and smooth patches of f triangles over v welded vertices."""

    vertices: FloatArray
    """Welded (v, 3) [m]."""
    corners: IntArray
    """Welded vertex of each face's corner (f, 3)."""
    normals: FloatArray
    """Unit normals (f, 3); neighbours agree about the side."""
    areas: FloatArray
    """(f,) [m^2]."""
    face_edges: IntArray
    """Edge from corner i to corner i + 1 of each face (f, 3)."""
    edge_vertices: IntArray
    """(e, 2)."""
    edge_faces: IntArray
    """The two faces of an edge (e, 2); -1 where there is no second, or more than two."""
    dihedral: FloatArray
    """Angle between the normals of an edge's two faces (e,) [rad]; pi at the rim of an open mesh."""
    sharp: BoolArray
    """Whether the surface has a crease there (e,)."""
    patch_corners: IntArray
    """As ``corners``, but with vertices on creases split, one for each smooth patch around them (f, 3)."""
    patch_count: int
    """Number of split vertices."""
    face_patch: IntArray
    """Label of the smooth patch that each face belongs to: those joined without crossing a crease (f,)."""
    crease_at: IntArray
    """One of the sharp edges at each welded vertex (v,), -1 where there is none."""


def build_topology(vertices: FloatArray, faces: IntArray, body: IntArray) -> Topology:
    """The topology of triangles: vertices (v, 3) [m], faces (f, 3), and the body of each face (f,)."""
    welded, corners = _weld(vertices, faces, body)
    first = welded[corners[:, 0]]
    cross = np.cross(welded[corners[:, 1]] - first, welded[corners[:, 2]] - first)
    double = np.linalg.norm(cross, axis=1)
    normals = cross / np.where(double > 0.0, double, 1.0)[:, None]
    face_edges, edge_vertices, edge_faces, opposed = _edges(corners)
    normals *= _agreement(edge_faces, opposed, len(faces))[:, None]
    dihedral = _dihedral(normals, edge_faces)
    sharp = _sharp(dihedral, face_edges, edge_faces)
    patch_corners, patch_count = _patches(corners, face_edges, edge_faces, sharp)
    crease_at = np.full(len(welded), -1, dtype=np.int64)
    crease_at[edge_vertices[sharp]] = np.nonzero(sharp)[0][:, None]
    return Topology(
        vertices=welded,
        corners=corners,
        normals=normals,
        areas=0.5 * double,
        face_edges=face_edges,
        edge_vertices=edge_vertices,
        edge_faces=edge_faces,
        dihedral=dihedral,
        sharp=sharp,
        patch_corners=patch_corners,
        patch_count=patch_count,
        face_patch=_joined(edge_faces[~sharp], len(faces)),
        crease_at=crease_at,
    )


def _weld(vertices: FloatArray, faces: IntArray, body: IntArray) -> tuple[FloatArray, IntArray]:
    """Vertices at the same place, of the same body, become one."""
    owner = np.zeros(len(vertices), dtype=np.int64)
    owner[faces] = body[:, None]
    used = np.zeros(len(vertices), dtype=np.bool_)
    used[faces] = True
    extent = float(np.ptp(vertices[used], axis=0).max())
    cell = np.round((vertices - vertices[used].min(axis=0)) / (WELD * extent)).astype(np.int64)
    # One odd 64-bit multiplier per coordinate: different cells share a key about once in 1e9 meshes.
    keys = np.column_stack([cell, owner]).view(np.uint64) * _KEY
    _, index, inverse = np.unique(keys.sum(axis=1), return_index=True, return_inverse=True)
    return vertices[index], inverse[faces].astype(np.int64)


def _edges(corners: IntArray) -> tuple[IntArray, IntArray, IntArray, BoolArray]:
    """face_edges, edge_vertices, edge_faces, and whether an edge's two faces run along it opposite ways."""
    start = corners.reshape(-1)
    stop = np.roll(corners, -1, axis=1).reshape(-1)
    key = np.minimum(start, stop) * (corners.max() + 1) + np.maximum(start, stop)
    order = np.argsort(key, kind="stable")
    fresh = np.diff(key[order], prepend=-1) != 0
    edge_of = np.zeros(len(key), dtype=np.int64)
    edge_of[order] = np.cumsum(fresh) - 1
    head = np.nonzero(fresh)[0]
    count = np.diff(np.append(head, len(key)))
    pair = count == 2
    one = order[head]
    two = order[np.minimum(head + 1, len(key) - 1)]
    edge_faces = np.stack([one // 3, np.where(pair, two // 3, -1)], axis=1)
    edge_vertices = np.stack([start[one], stop[one]], axis=1)
    return edge_of.reshape(-1, 3), edge_vertices, edge_faces, pair & (start[one] != start[two])


def _agreement(edge_faces: IntArray, opposed: BoolArray, faces: int) -> FloatArray:
    """+1 or -1 for each face, such that neighbours wound against each other get different signs."""
    pair = edge_faces[:, 1] >= 0
    if bool(opposed[pair].all()):
        return np.ones(faces)
    # Each face stands twice, as it is and turned over; links join the versions that agree.
    a, b = edge_faces[pair].T
    flip = np.where(opposed[pair], 0, faces)
    rows = np.concatenate([a, a + faces])
    columns = np.concatenate([b + flip, (b + flip + faces) % (2 * faces)])
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(2 * faces, 2 * faces))
    _, label = connected_components(graph, directed=False)
    as_is, turned = label[:faces], label[faces:]
    # Of the two versions of a connected piece the one met first is kept. A one-sided piece has a single
    # version.
    return np.where(as_is <= turned, 1.0, -1.0)


def _dihedral(normals: FloatArray, edge_faces: IntArray) -> FloatArray:
    one, two = normals[edge_faces[:, 0]], normals[edge_faces[:, 1]]
    angle = np.arctan2(np.linalg.norm(np.cross(one, two), axis=1), np.einsum("ij,ij->i", one, two))
    return np.where(edge_faces[:, 1] >= 0, angle, np.pi)


def _sharp(dihedral: FloatArray, face_edges: IntArray, edge_faces: IntArray) -> BoolArray:
    """Creases: turned much in themselves, or much more than the other edges of their two faces."""
    sharp = dihedral > SHARP
    doubtful = np.nonzero((dihedral > SHARP_AMONG_FLAT) & ~sharp)[0]
    around = dihedral[face_edges[edge_faces[doubtful]]].reshape(-1, 6)
    # The edge itself stands twice among the six; without it the middle two of four make the median.
    own = face_edges[edge_faces[doubtful]].reshape(-1, 6) == doubtful[:, None]
    around = np.sort(np.where(own, np.inf, around), axis=1)
    sharp[doubtful] = dihedral[doubtful] > MUCH_LESS * 0.5 * (around[:, 1] + around[:, 2])
    return np.asarray(sharp)


def _patches(
    corners: IntArray, face_edges: IntArray, edge_faces: IntArray, sharp: BoolArray
) -> tuple[IntArray, int]:
    """Corners of faces joined over smooth edges: one label per vertex and smooth patch around it."""
    smooth = np.nonzero(~sharp)[0]
    slots = np.arange(corners.size, dtype=np.int64).reshape(corners.shape)
    links = []
    for side in (0, 1):
        face = edge_faces[smooth, side]
        local = np.argmax(face_edges[face] == smooth[:, None], axis=1)
        ends = np.stack([local, (local + 1) % 3], axis=1)
        vertex = np.take_along_axis(corners[face], ends, axis=1)
        slot = np.take_along_axis(slots[face], ends, axis=1)
        # In order of the vertex, so that both faces list the same two vertices alike.
        links.append(np.take_along_axis(slot, np.argsort(vertex, axis=1), axis=1).reshape(-1))
    graph = coo_array(
        (np.ones(len(links[0]), dtype=np.int8), (links[0], links[1])), shape=(corners.size, corners.size)
    )
    count, label = connected_components(graph, directed=False)
    return label.reshape(corners.shape).astype(np.int64), int(count)


def _joined(pairs: IntArray, count: int) -> IntArray:
    """Labels (count,) of what the pairs (k, 2) join."""
    ones = np.ones(len(pairs), dtype=np.int8)
    graph = coo_array((ones, (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)
