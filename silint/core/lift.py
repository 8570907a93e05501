"""Lifting shade points off the surfaces that they lie on.

A point p with normal n is moved to p' = p + delta n, so that the faces it lies on are behind or before it and
not through it. That leaves the faces that hold n itself: the walls round the foot of which a floor is baked.
Those that touch p are found, and p' is moved a little to their front too: a point in the corner of a room
sees the room, on either side of rounding. All else sees the point p' as it is.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from silint.core.face_bundles import BLOCK, CENTRE, HALF
from silint.core.jit import FILTER, INNER, PARALLEL
from silint.core.lanes import WIDTH, lowest

# A face counts as holding n when the sine of the angle between them is below this.
TANGENT = 2.0**-12

# float32 keeps a coordinate to well within this.
SLACK = 2.0**-22

_UW = np.uint64(WIDTH)
_CX, _CY, _CZ = (np.uint64((CENTRE + i) * WIDTH) for i in range(3))
_HX, _HY, _HZ = (np.uint64((HALF + i) * WIDTH) for i in range(3))


@njit(**PARALLEL)
def lift_points(geometry, tree, points, normals, lift, nudge, touch, out):
    """Move points off the mesh.

    Parameters
    ----------
    geometry : Topology
    tree : FaceBundles
    points, normals : (n, 3) float64
        In scaled units; unit normals.
    lift, nudge, touch : float
        Distances along n, along the mean normal of touched faces that hold n, and within which a face is
        touched; all relative to the larger of the scene and the point's distance from the origin.
    out : (n, 3) float64, out
    """
    for i in prange(len(points)):
        p = points[i, 0], points[i, 1], points[i, 2]
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        size = max(1.0, abs(p[0]), abs(p[1]), abs(p[2]))
        t0, t1, t2 = _touched_front(geometry, tree, p, n, touch * size)
        out[i, 0] = p[0] + size * (lift * n[0] + nudge * t0)
        out[i, 1] = p[1] + size * (lift * n[1] + nudge * t1)
        out[i, 2] = p[2] + size * (lift * n[2] + nudge * t2)


@njit(**FILTER)
def _near_mask(nodes, block, px, py, pz, near):
    """Lanes of a block of boxes that come near a point."""
    base = np.uint64(block) * np.uint64(BLOCK)
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        drop = (abs(nodes[j + _CX] - px) > nodes[j + _HX] + near) | (
            abs(nodes[j + _CY] - py) > nodes[j + _HY] + near
        )
        drop |= (abs(nodes[j + _CZ] - pz) > nodes[j + _HZ] + near) | (nodes[j + _HX] < np.float32(0.0))
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)


@njit(**INNER)
def _touched_front(geometry, tree, p, n, touch):
    """Unit mean of the normals of the faces that touch p and hold n; zero if there are none."""
    x, y, z = 0.0, 0.0, 0.0
    planes, nodes, levels = geometry.planes, tree.nodes, tree.levels
    # Boxes are of float32, with a margin of its rounding.
    near = np.float32(touch + SLACK * max(1.0, abs(p[0]), abs(p[1]), abs(p[2])))
    px, py, pz = np.float32(p[0]), np.float32(p[1]), np.float32(p[2])
    stack = np.empty((256, 2), np.int64)
    top = 1 if len(tree.order) > 0 else 0
    stack[0, 0], stack[0, 1] = len(levels) - 2, 0
    while top > 0:
        top -= 1
        level, block = stack[top, 0], stack[top, 1]
        mask = _near_mask(nodes, levels[level] + block, px, py, pz, near)
        while mask != 0:
            child = block * WIDTH + lowest(mask)
            mask &= mask - 1
            if level > 0:
                if levels[level - 1] + child < levels[level]:
                    stack[top, 0], stack[top, 1] = level - 1, child
                    top += 1
                continue
            for j in range(child * WIDTH, min((child + 1) * WIDTH, len(tree.order))):
                f = tree.order[j]
                code = geometry.face_planes[f]
                k = max(code, ~code)
                if abs(planes[k, 0] * n[0] + planes[k, 1] * n[1] + planes[k, 2] * n[2]) > TANGENT:
                    continue
                sign = 1.0 if code >= 0 else -1.0
                if _touches(geometry.vertices, geometry.faces, f, planes, k, sign, p, touch):
                    x += sign * planes[k, 0]
                    y += sign * planes[k, 1]
                    z += sign * planes[k, 2]
    length = np.sqrt(x * x + y * y + z * z)
    if length < 0.125:
        return 0.0, 0.0, 0.0  # none, or sheets back to back
    return x / length, y / length, z / length


@njit(**INNER)
def _touches(vertices, faces, f, planes, k, sign, p, touch):
    """True where p lies on the face, up to `touch`."""
    if abs(planes[k, 0] * p[0] + planes[k, 1] * p[1] + planes[k, 2] * p[2] + planes[k, 3]) > touch:
        return False
    for i in range(3):
        a, b = faces[f, i], faces[f, (i + 1) % 3]
        ex = vertices[b, 0] - vertices[a, 0]
        ey = vertices[b, 1] - vertices[a, 1]
        ez = vertices[b, 2] - vertices[a, 2]
        # Outwards in the plane, as long as the edge.
        ox = sign * (ey * planes[k, 2] - ez * planes[k, 1])
        oy = sign * (ez * planes[k, 0] - ex * planes[k, 2])
        oz = sign * (ex * planes[k, 1] - ey * planes[k, 0])
        beyond = ox * (p[0] - vertices[a, 0]) + oy * (p[1] - vertices[a, 1]) + oz * (p[2] - vertices[a, 2])
        if beyond > touch * (abs(ex) + abs(ey) + abs(ez)):
            return False
    return True
