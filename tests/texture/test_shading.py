from __future__ import annotations

import numpy as np
import pytest
import trimesh

from silint.texture.shading import CREASE, corner_normals, corner_tangents, face_normals, frames
from tests.texture.shapes import box, grid


def normals_of(vertices, faces, own=None):
    vertices = np.asarray(vertices, float)
    _, welded = np.unique(vertices, axis=0, return_inverse=True)
    corners = vertices[faces]
    flat = face_normals(corners)
    return corners, welded.ravel()[faces], flat, corner_normals(corners, welded.ravel()[faces], flat, own)


def test_a_ball_is_smooth_and_a_box_is_not():
    ball = trimesh.creation.icosphere(3)
    corners, _, _, normals = normals_of(ball.vertices, ball.faces)
    assert (normals * corners).sum(axis=2).min() > 0.9999  # radial
    vertices, faces, _ = box()
    _, _, flat, normals = normals_of(vertices, faces)
    np.testing.assert_allclose(normals, np.repeat(flat[:, None], 3, axis=1), atol=1e-15)


@pytest.mark.parametrize(("bend", "soft"), [(CREASE - 1.0, True), (CREASE + 1.0, False)])
def test_edges_are_hard_from_the_crease_on(bend, soft):
    a = np.radians(bend)
    vertices = np.array([[0, 0, 0], [0, 1, 0], [-1, 0, 0], [np.cos(a), 0, np.sin(a)]])
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    _, _, flat, normals = normals_of(vertices, faces)
    # The angles at both ends are alike, so that a soft edge halves the bend.
    middle = (flat[0] + flat[1]) / np.linalg.norm(flat[0] + flat[1])
    np.testing.assert_allclose(normals[0, 0], middle if soft else flat[0], atol=1e-12)
    np.testing.assert_allclose(normals[0, 2], flat[0], atol=1e-12)


def test_a_files_normals_are_taken_and_missing_ones_are_the_faces():
    vertices, faces, _ = grid((0, 0, 0), (1, 0, 0), (0, 1, 0))
    own = np.tile([0.0, 3.0, 4.0], (2, 3, 1))
    own[0, 1] = 0.0
    own[1, 2] = np.nan
    normals = normals_of(vertices, faces, own)[3]
    np.testing.assert_allclose(normals[0, 0], (0.0, 0.6, 0.8))
    for corner in (normals[0, 1], normals[1, 2]):
        np.testing.assert_allclose(corner, (0.0, 0.0, 1.0))


def test_sizes_do_not_matter():
    vertices, faces, _ = box()
    reference = face_normals(vertices[faces])
    for scale in (1e-200, 1e150):
        np.testing.assert_allclose(face_normals(scale * vertices[faces]), reference, atol=1e-15)
    assert not face_normals(np.zeros((1, 3, 3))).any()


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("degrees", [0.0, 30.0, 200.0])
def test_tangents_run_along_growing_u(mirror, degrees):
    vertices, faces, uvs = grid((0, 0, 0), (2, 0, 0), (0, 1, 0), 2)
    turn = np.radians(degrees)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    linear = rotation @ np.diag([-1.0 if mirror else 1.0, 1.0])  # uv of (x / 2, y)
    corners, welded, _, normals = normals_of(vertices, faces)
    tangents = corner_tangents(corners, uvs @ linear.T, welded, normals)
    assert (tangents.sign == (-1.0 if mirror else 1.0)).all()
    # dp/du and dp/dv: columns of the inverse.
    inverse = np.diag([2.0, 1.0]) @ np.linalg.inv(linear)
    along_u = np.append(inverse[:, 0], 0.0) / np.linalg.norm(inverse[:, 0])
    np.testing.assert_allclose(tangents.tangent, np.broadcast_to(along_u, normals.shape), atol=1e-12)
    frame = frames(normals[:, 0], tangents.tangent[:, 0], tangents.sign)
    np.testing.assert_allclose(
        frame @ frame.transpose(0, 2, 1), np.tile(np.eye(3), (len(frame), 1, 1)), atol=1e-12
    )
    assert (frame[:, 1] @ np.append(inverse[:, 1], 0.0) > 0.0).all()  # towards growing v


def test_tangents_of_a_cylinder_are_smooth_but_for_its_seam():
    """u runs round it: at shared corners both faces have one tangent, the analytic one."""
    n = 24
    angle = 2 * np.pi * np.arange(n + 1) / n
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices = np.concatenate([np.c_[ring, np.zeros(n + 1)], np.c_[ring, np.ones(n + 1)]])
    i = np.arange(n)
    faces = np.concatenate([np.c_[i, i + 1, i + n + 2], np.c_[i, i + n + 2, i + n + 1]])
    uvs = np.c_[np.tile(angle / (2 * np.pi), 2), np.repeat([0.0, 1.0], n + 1)][faces]
    _, welded = np.unique(vertices.round(9), axis=0, return_inverse=True)
    corners = vertices[faces]
    normals = corners * (1, 1, 0)
    tangent = corner_tangents(corners, uvs, welded.ravel()[faces], normals).tangent
    expected = np.cross((0.0, 0.0, 1.0), normals)
    inner = (uvs[..., 0] > 0.01) & (uvs[..., 0] < 0.99)
    np.testing.assert_allclose(tangent[inner], expected[inner], atol=1e-12)


def test_frames_without_tangents_are_still_frames():
    normals = np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 0.0]])
    frame = frames(normals, normals, np.ones(2))
    np.testing.assert_allclose(np.linalg.det(frame), 1.0, atol=1e-12)
    np.testing.assert_allclose(frame[:, 2], normals / [[2.0], [1.0]])
