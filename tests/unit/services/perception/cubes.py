"""Frames of a marker cube or of nothing, with true depth, exact to the pixel."""

from functools import cache

import cv2
import numpy as np

from common.die import DIE
from services.perception.config import CubeConfig
from services.perception.frames import Frame
from services.perception.tags import dictionary_of
from tests.unit.services.perception.flat import CAMERA_MATRIX, HEIGHT, WIDTH, blank, lay, noisy, shrunk

MARKERS = CubeConfig()
TABLE_M = 0.9  # of depth behind it
_V, _U = np.mgrid[0:HEIGHT, 0:WIDTH]
_RAYS = np.stack(
    [
        (_U - CAMERA_MATRIX[0, 2]) / CAMERA_MATRIX[0, 0],
        (_V - CAMERA_MATRIX[1, 2]) / CAMERA_MATRIX[1, 1],
        np.ones(_U.shape),
    ],
    axis=-1,
)


def print_of(face):
    """A face's paper: its marker with a white border, as large as the cube's face."""
    marker = cv2.aruco.generateImageMarker(dictionary_of(MARKERS.dictionary), MARKERS.first + face, 120)
    border = round(120 * (DIE.size_m / MARKERS.marker_m - 1) / 2)
    return np.pad(marker, border, constant_values=255)


PRINTS = [print_of(face) for face in range(6)]
PIPS = [cv2.cvtColor(DIE.face_image(face + 1, 160), cv2.COLOR_RGB2GRAY) for face in range(6)]
# A print's frame has y down and z into the paper; rows are the axes of a face: right, up, outward.
_AS_PRINTED = np.diag([1.0, -1.0, -1.0])


def frame(T_camera_die=None, number=0, t_ns=None, *, noise=2.0, hidden=None, second=None, pips=False):
    """A picture of the cube (None: without one), another one perhaps; `hidden` (rows, columns) is nearer.

    With `pips` its faces are those of the die.
    """
    drawn, depth = _drawn(pips, _key(second), _key(T_camera_die))
    colour, depth = noisy(drawn, noise, number), depth.copy()
    if hidden is not None:
        colour[hidden], depth[hidden] = 60, 0.2
    t_ns = number * 33_000_000 if t_ns is None else t_ns
    millimetres = np.rint(1e3 * depth).astype(np.uint16)
    return Frame(colour, millimetres, 0.001, CAMERA_MATRIX, t_ns, t_ns, number)


def _key(pose):
    return None if pose is None else tuple(np.ravel(pose).tolist())


@cache
def _drawn(pips, *poses):
    """Grey (H, W) and depth (H, W) without noise; most tests show one pose again and again."""
    canvas, depth = blank(), np.full((HEIGHT, WIDTH), TABLE_M)
    for pose in poses:
        if pose is not None:
            draw_cube(canvas, depth, np.reshape(pose, (4, 4)), PIPS if pips else PRINTS)
    return shrunk(canvas), depth


def draw_cube(canvas, depth, pose, prints):
    for face in range(6):
        normal = pose[:3, :3] @ DIE.normals[face]
        middle = pose[:3, 3] + DIE.half_m * normal
        if normal @ middle >= 0:
            continue
        paper = np.eye(4)
        paper[:3, :3] = pose[:3, :3] @ DIE.frames[face].T @ _AS_PRINTED
        paper[:3, 3] = middle
        lay(canvas, prints[face], paper, (DIE.size_m, DIE.size_m), centred=True)
        distance = (normal @ middle) / (_RAYS @ normal)
        arms = (_RAYS * distance[..., None] - pose[:3, 3]) @ pose[:3, :3]
        on_face = (np.abs(arms) <= DIE.half_m + 1e-9).all(axis=-1) & (distance > 0)
        depth[on_face] = distance[on_face]
