"""Is a mesh closed, and which way do its faces look?

A body is what hangs together by edges that two faces share.  It is closed if every edge of it is shared by
just two faces and the faces can be turned so that they all look to one side.  The faces of a closed body are
turned outwards; those of a body inside another one's skin (a room in a hollow block) look away from the
material between the two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Wound:
    """Faces (f, 3) after turning, whether all bodies are closed, and how many faces were turned."""

    faces: IntArray
    closed: bool
    turned: int


def wind(vertices: FloatArray, faces: IntArray) -> Wound:
    """Turn the faces of closed bodies outwards; faces of other bodies stay as they are.

    Parameters
    ----------
    vertices
        (k, 3); vertices at one place must be one vertex.
    faces
        (f, 3), each vertex once, no two faces on the same three vertices.
    """
    from scipy import sparse  # for meshes only

    f = len(faces)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    upwards = start < end
    key = np.minimum(start, end) * len(vertices) + np.maximum(start, end)
    _, number, count = np.unique(key, return_inverse=True, return_counts=True)
    pair = np.argsort(number, kind="stable")
    pair = pair[count[number[pair]] == 2].reshape(-1, 2)  # two sides of faces on one edge
    one, two = pair[:, 0] // 3, pair[:, 1] // 3
    opposed = (upwards[pair[:, 0]] != upwards[pair[:, 1]]).astype(np.int64)  # then both look to one side
    # nodes i and f + i: face i as it is, and turned
    links = [(one, two + f * (1 - opposed)), (one + f, two + f * opposed)]
    rows, columns = (np.concatenate([link[k] for link in links]) for k in (0, 1))
    graph = sparse.coo_array((np.ones(len(rows), bool), (rows, columns)), shape=(2 * f, 2 * f))
    _, label = sparse.csgraph.connected_components(graph, directed=False)
    as_is, turned = label[:f], label[f:]
    _, body = np.unique(np.minimum(as_is, turned), return_inverse=True)
    bodies = int(body.max()) + 1 if f else 0
    turn = as_is > turned
    closed = np.ones(bodies, bool)
    closed[body[as_is == turned]] = False  # a Moebius strip
    closed[body[np.flatnonzero(count[number] != 2) // 3]] = False
    volume = _volumes(vertices, faces, turn, body, bodies)
    closed &= volume != 0.0
    inwards = (volume < 0.0) != (_depths(vertices, faces, body, closed) % 2 == 1)
    turn = (turn != inwards[body]) & closed[body]
    out = faces.copy()
    out[turn] = out[turn][:, ::-1]
    return Wound(out, bool(np.all(closed)), int(np.sum(turn)))


def _volumes(
    vertices: FloatArray, faces: IntArray, turn: NDArray[np.bool_], body: IntArray, bodies: int
) -> FloatArray:
    """Return the signed volume of each body, positive with the faces outwards (divergence theorem)."""
    corner = vertices[faces]
    first = np.full(bodies, -1, np.int64)
    first[body[::-1]] = np.arange(len(faces))[::-1]
    corner = corner - corner[first[body], 0][:, None]  # from a vertex of the body, to keep the digits
    six = np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2]))
    return np.asarray(np.bincount(body, np.where(turn, -six, six) / 6.0, bodies), np.float64)


def _depths(vertices: FloatArray, faces: IntArray, body: IntArray, closed: NDArray[np.bool_]) -> IntArray:
    """Return in how many closed bodies each one lies, (bodies,)."""
    bodies = len(closed)
    depth = np.zeros(bodies, np.int64)
    if bodies < 2:
        return depth
    corner = vertices[faces]
    low, high = np.full((bodies, 3), np.inf), np.full((bodies, 3), -np.inf)
    np.minimum.at(low, body, corner.min(axis=1))
    np.maximum.at(high, body, corner.max(axis=1))
    order = np.argsort(body, kind="stable")
    first = np.searchsorted(body[order], np.arange(bodies + 1))
    for outer in np.flatnonzero(closed):
        inside = np.all((low >= low[outer]) & (high <= high[outer]), axis=1)
        inside[outer] = False
        for inner in np.flatnonzero(inside):
            p = corner[order[first[inner]]].mean(axis=0)
            depth[inner] += _contains(corner[order[first[outer] : first[outer + 1]]], p)
    return depth


def _contains(corner: FloatArray, p: FloatArray) -> bool:
    """Say whether the closed body of the triangles (f, 3, 3) contains `p`: an odd number of crossings."""
    d = np.array([0.3137, 0.5591, 0.7675])  # along no likely edge
    u, v, r = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], p - corner[:, 0]
    q = np.cross(d, v)
    with np.errstate(divide="ignore", invalid="ignore"):  # parallel: nan or inf, not hit
        inverse = 1.0 / np.einsum("ij,ij->i", u, q)
        a = np.einsum("ij,ij->i", r, q) * inverse
        s = np.cross(r, u)
        b = (s @ d) * inverse
        t = np.einsum("ij,ij->i", v, s) * inverse
        hit = (a >= 0.0) & (b >= 0.0) & (a + b <= 1.0) & (t > 0.0)
    return bool(np.sum(hit) % 2 == 1)
