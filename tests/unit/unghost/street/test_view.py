"""Projecting triangles to the screen: clipping, hidden faces, and closed meshes."""

import numpy as np
import pytest

from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import Transform
from unghost.street.mesh import Mesh, ball, block, join, loft, tube
from unghost.street.paint import CONCRETE, Paint, Tag
from unghost.street.raster import NEAR, to_screen

CAMERA = Camera.from_fov(200, 100, 90, Transform())


def project(mesh, two_sided=False):
    sides = np.full(len(mesh), two_sided)
    return to_screen(mesh.corners, mesh.normals, CAMERA, sides)


@pytest.mark.parametrize(
    ("low", "high", "faces"),
    [
        pytest.param((5, -1, -1), (7, 1, 1), 1, id="straight ahead shows its front"),
        pytest.param((5, 2, -1), (7, 3, 1), 2, id="to the right shows a side too"),
        pytest.param(
            (5, 2, 2), (7, 3, 2.5), 3, id="to the right and above shows three"
        ),
        pytest.param((-7, -1, -1), (-5, 1, 1), 0, id="behind the camera shows nothing"),
        pytest.param((1, 5, -1), (2, 6, 1), 0, id="beside the view shows nothing"),
    ],
)
def test_only_faces_towards_the_camera_are_projected(low, high, faces):
    _, source = project(block(low, high, CONCRETE, Tag.WALL))

    assert len(source) == 2 * faces


def test_triangles_are_clipped_at_the_near_plane():
    corners = np.array([[(-5.0, 0.0, -1.0), (5.0, -1.0, -1.0), (5.0, 1.0, -1.0)]])
    normals = np.zeros_like(corners) + np.array([0.0, 0.0, 1.0])

    screen, source = project(Mesh.of(corners, normals, CONCRETE, Tag.ROAD))

    assert source.tolist() == [0, 0]
    assert screen[..., 2].max() == pytest.approx(1 / NEAR)
    assert np.isfinite(screen).all()


@pytest.mark.parametrize(
    "mesh",
    [
        pytest.param(tube((0, 0, 0), (1, 2, 3), (0.5, 0.2), (CONCRETE, 1)), id="tube"),
        pytest.param(ball((1, 2, 3), (0.5, 0.8, 0.2), (CONCRETE, 1)), id="ball"),
        pytest.param(block((0, 0, 0), (1, 2, 3), CONCRETE, 1), id="block"),
        pytest.param(
            loft(
                np.array(
                    [
                        [(x, y, z) for y, z in ((-1, 0), (1, 0), (1, 1), (-1, 1))]
                        for x in (0.0, 2.0, 3.0)
                    ]
                ),
                [[CONCRETE]],
                1,
            ),
            id="loft",
        ),
    ],
)
def test_solids_are_closed_and_face_outwards(mesh):
    a, b, c = np.moveaxis(mesh.corners, 1, 0)
    plane = np.cross(b - a, c - a)
    outwards = np.sum(plane * mesh.normals.sum(axis=1), axis=1)
    oriented = np.where(outwards[:, None] < 0, -plane, plane)

    # Gauss: the oriented areas of a closed surface add up to 0, and enclose a volume.
    assert oriented.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-9)
    assert np.sum(oriented * (a - a.mean(axis=0))) > 0


def test_dyeing_changes_only_dyeable_paint():
    mesh = join(
        [
            block((0, 0, 0), (1, 1, 1), Paint.dye(1), 1),
            block((2, 0, 0), (3, 1, 1), CONCRETE, 1),
        ]
    )

    dyed = mesh.dyed({1: (255, 0, 0)})

    assert dyed.surface[:12, :3] == pytest.approx(np.tile([1.0, 0.0, 0.0], (12, 1)))
    assert np.array_equal(dyed.surface[12:], mesh.surface[12:])
