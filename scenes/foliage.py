"""Foliage: young trees of branching stems whose twigs carry diamond leaves, nearly all edges boundaries.

Provenance: written for silint; the plan (each stem carries children spread by the golden angle) is textbook
phyllotaxis, as in P. Prusinkiewicz and A. Lindenmayer, "The Algorithmic Beauty of Plants", 1990. No data
file.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.mesh import Mesh, as_mesh, boxes, concatenate, tubes

Points = NDArray[np.float64]  # (n, 3)

GOLDEN_ANGLE = np.pi * (3.0 - 5.0**0.5)
CHILDREN = (6, 5, 4)  # stems that a trunk, a bough and a branch carry: 6 boughs, 30 branches, 120 twigs
SIDES, SEGMENTS = 5, 3  # of a stem's tube


def foliage(trees: int = 5, leaves_per_twig: int = 80, seed: int = 0) -> Mesh:
    """Trees on a slab: ``trees * (120 * leaves_per_twig * 2 + 157 * 30) + 12`` triangles, z up.

    A leaf is two triangles folded along their midrib, single-sided geometry with four boundary edges of five;
    stems are thin tubes, open at both ends.
    """
    rng = np.random.default_rng(seed)
    # Roots on a circle with a tree in the middle, far enough apart for the sky to show between the crowns.
    around = 2.0 * np.pi * np.arange(trees - 1) / max(trees - 1, 1)
    foot = np.zeros((trees, 3))
    foot[1:, :2] = 4.5 * np.stack([np.cos(around), np.sin(around)], axis=1)
    tip = foot + np.stack([0.6 * rng.random(trees), 0.6 * rng.random(trees), 3.5 + rng.random(trees)], axis=1)

    stems = [_stems(foot, tip, 0.12)]
    for depth, children in enumerate(CHILDREN):
        foot, tip = _children(rng, foot, tip, children)
        stems.append(_stems(foot, tip, 0.12 * 0.45 ** (depth + 1)))
    ground = boxes((-8.0, -8.0, -0.2), (8.0, 8.0, 0.0))
    return concatenate([*stems, _leaves(rng, foot, tip, leaves_per_twig), ground])


def _stems(foot: Points, tip: Points, radius: float) -> Mesh:
    """Tapered open tubes from `foot` to `tip`."""
    t = np.linspace(0.0, 1.0, SEGMENTS + 1)
    paths = _along(foot, tip, np.broadcast_to(t, (len(foot), len(t))))
    return tubes(paths, radius * (1.0 - 0.6 * t), SIDES, reference=(0.8, 0.36, -0.48), caps=False)


def _along(foot: Points, tip: Points, t: Points) -> Points:
    """Points (n, k, 3) at parameters `t` (n, k) of the stems, which bend a little upwards on their way."""
    points = foot[:, None] + t[..., None] * (tip - foot)[:, None]
    points[..., 2] -= 0.15 * np.linalg.norm(tip - foot, axis=1)[:, None] * t * (1.0 - t)
    return points


def _children(rng: np.random.Generator, foot: Points, tip: Points, children: int) -> tuple[Points, Points]:
    """Feet and tips of `children` stems on the upper part of each stem, turned on by the golden angle."""
    n = len(foot)
    axis = tip - foot
    length = np.linalg.norm(axis, axis=1, keepdims=True)
    along, side, other = _frames(axis)
    t = 0.35 + 0.6 * (np.arange(children) + 0.5) / children
    turn = GOLDEN_ANGLE * np.arange(children) + 2.0 * np.pi * rng.random((n, 1))
    spread = np.cos(turn)[..., None] * side[:, None] + np.sin(turn)[..., None] * other[:, None]
    heading = spread + along[:, None] * (0.5 + 0.4 * rng.random((n, children, 1)))
    heading[..., 2] += 0.25
    heading /= np.linalg.norm(heading, axis=2, keepdims=True)
    reach = (0.75 - 0.35 * t)[None, :, None] * length[:, None] * (0.8 + 0.4 * rng.random((n, children, 1)))
    base = _along(foot, tip, np.broadcast_to(t, (n, children)))
    return base.reshape(-1, 3), (base + reach * heading).reshape(-1, 3)


def _leaves(rng: np.random.Generator, foot: Points, tip: Points, count: int) -> Mesh:
    """`count` leaves along each twig: base, right, tip, left; the two triangles share the midrib."""
    n = len(foot)
    axis = tip - foot
    along, side, other = _frames(axis)
    t = (np.arange(count) + rng.random((n, count))) / count
    turn = GOLDEN_ANGLE * np.arange(count) + rng.random((n, count))
    spread = np.cos(turn)[..., None] * side[:, None] + np.sin(turn)[..., None] * other[:, None]
    rib = spread + along[:, None] * (0.3 + 0.9 * rng.random((n, count, 1)))
    rib[..., 2] -= 0.3
    rib /= np.linalg.norm(rib, axis=2, keepdims=True)
    tilt = rng.random((n, count, 3)) - 0.5 + (0.0, 0.0, 0.8)  # leaves like to face the sky
    across = np.cross(rib, tilt)
    across /= np.linalg.norm(across, axis=2, keepdims=True)
    normal = np.cross(across, rib)

    size = 0.07 + 0.06 * rng.random((n, count, 1))
    # The leaf begins a stalk's length away from the twig, so that leaves do not cut through it.
    base = _along(foot, tip, t) + 0.03 * rib
    waist = base + 0.45 * size * rib - 0.08 * size * normal
    corners = [base, waist + 0.35 * size * across, base + size * rib, waist - 0.35 * size * across]
    faces = np.array([(0, 1, 2), (0, 2, 3)])
    return as_mesh(np.stack(corners, axis=2), faces[None] + 4 * np.arange(n * count)[:, None, None])


def _frames(axis: Points) -> tuple[Points, Points, Points]:
    """Unit vector along each row of `axis` and two more that complete it to a right-handed frame."""
    along = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    # Cross with the coordinate axis that is farthest from parallel.
    side = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return along, side, np.cross(along, side)
