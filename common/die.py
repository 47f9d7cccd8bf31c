"""The die: size, faces, pips, colours, its surface as a mesh and as pictures; for twin and perception.

Letters: F 6 faces, N pixels a side, V vertices, T triangles. Metres; the die's frame has its origin in the
centre and its axes through the faces.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common import geometry

Float64 = NDArray[np.float64]
Rgb = tuple[int, int, int]

FACES = 6
# Where the pips of a face are, in units of `pip_spacing_m` to the right and upwards.
_DIAGONAL = ((-1, 1), (1, -1))
_CORNERS = (*_DIAGONAL, (-1, -1), (1, 1))
PIPS: tuple[tuple[tuple[int, int], ...], ...] = (
    ((0, 0),),
    _DIAGONAL,
    ((0, 0), *_DIAGONAL),
    _CORNERS,
    ((0, 0), *_CORNERS),
    (*_CORNERS, (-1, 0), (1, 0)),
)
# How often each face's pips are turned by a quarter, counter-clockwise seen from outside.
NO_QUARTERS = (0, 0, 0, 0, 0, 0)
_GRID = 8  # rounded edges are drawn with so many steps a side
_SMOOTH = 4  # pictures are drawn at so many times their size, then averaged


@dataclass(frozen=True)
class Mesh:
    """Vertices (V, 3) m, triangles (T, 3) counter-clockwise from outside, texture coordinates (V, 2).

    (0, 0) is the picture's upper left corner; `Die.atlas` is the picture.
    """

    vertices: Float64
    triangles: NDArray[np.int32]
    uv: Float64


@dataclass(frozen=True)
class Die:
    """A cubic die; the defaults are a white one of 60 mm with dark pips.

    The paper gives the size alone (Sec. II-B). `mass_kg` is that of the 50 mm cube in the maker's own
    simulated task. `right_handed`: 1, 2, 3 run counter-clockwise about their corner, as on Western dice.
    `quarters`: how often the pips of faces 1 to 6 are turned by 90 degrees; makers differ in 2, 3 and 6.
    """

    size_m: float = 0.060
    corner_radius_m: float = 0.004
    mass_kg: float = 0.1
    pip_radius_m: float = 0.005
    pip_spacing_m: float = 0.015
    body_rgb: Rgb = (236, 236, 230)
    pip_rgb: Rgb = (25, 25, 28)
    right_handed: bool = True
    quarters: tuple[int, int, int, int, int, int] = NO_QUARTERS

    @property
    def light_pips(self) -> bool:
        """Polarity: whether pips are lighter than the body."""
        return _luminance(self.pip_rgb) > _luminance(self.body_rgb)

    @property
    def half_m(self) -> float:
        """Half the length of an edge."""
        return self.size_m / 2

    @property
    def normals(self) -> Float64:
        """Outward normals (F, 3) of faces 1 to 6; opposite faces sum to seven."""
        three = 1.0 if self.right_handed else -1.0
        half = np.diag([1.0, 1.0, three])
        return np.concatenate([half, -half[::-1]])

    @property
    def frames(self) -> Float64:
        """Axes (F, 3, 3) of each face: rows are right, up and outward, seen from outside."""
        normals = self.normals
        ups = np.roll(np.abs(normals), 1, axis=1)
        return np.stack([np.cross(ups, normals), ups, normals], axis=1)

    @property
    def inertia(self) -> Float64:
        """Diagonal inertia (3,), kg·m², of a solid cube."""
        return np.full(3, self.mass_kg * self.size_m**2 / 6)

    def pip_offsets(self, face: int) -> Float64:
        """Centres (face, 2) of a face's pips, m to the right and upwards of its middle."""
        grid = np.array(PIPS[face - 1], np.float64)
        for _ in range(self.quarters[face - 1] % 4):
            grid = np.stack([-grid[:, 1], grid[:, 0]], axis=1)
        return self.pip_spacing_m * grid

    def pips_of(self, face: int) -> Float64:
        """Centres (face, 3) of a face's pips on its surface."""
        offsets = np.full((face, 3), self.half_m)
        offsets[:, :2] = self.pip_offsets(face)
        return offsets @ self.frames[face - 1]

    def face_image(self, face: int, pixels: int = 128) -> NDArray[np.uint8]:
        """Picture (N, N, 3), RGB, of a whole face from edge to edge, its first row at the top."""
        fine = pixels * _SMOOTH
        at = ((np.arange(fine) + 0.5) / fine - 0.5) * self.size_m
        right, up = np.meshgrid(at, -at)
        pips = self.pip_offsets(face)
        squared = (right[..., None] - pips[:, 0]) ** 2 + (up[..., None] - pips[:, 1]) ** 2
        inside = (squared <= self.pip_radius_m**2).any(axis=-1)
        share = inside.reshape(pixels, _SMOOTH, pixels, _SMOOTH).mean(axis=(1, 3))[..., None]
        body, pip = np.array(self.body_rgb), np.array(self.pip_rgb)
        return np.rint((1 - share) * body + share * pip).astype(np.uint8)

    def atlas(self, pixels: int = 128) -> NDArray[np.uint8]:
        """The pictures of faces 1 to 6 side by side: (N, F·N, 3), RGB."""
        return np.concatenate([self.face_image(face, pixels) for face in range(1, FACES + 1)], axis=1)

    def mesh(self) -> Mesh:
        """The surface with rounded edges and corners, textured by `atlas`."""
        steps, triangles = self._steps(), _grid_triangles(_GRID)
        right, up = (x.ravel() for x in np.meshgrid(steps, steps))
        plane = np.stack([right, up, np.full_like(right, self.half_m)], axis=1)
        inner = self.half_m - self.corner_radius_m
        core = np.clip(plane, -inner, inner)
        outward = plane - core
        rounded = core + self.corner_radius_m * outward / np.linalg.norm(outward, axis=1, keepdims=True)
        across = 0.5 + right / self.size_m
        uv = [np.stack([(face + across) / FACES, 0.5 - up / self.size_m], axis=1) for face in range(FACES)]
        return Mesh(
            np.concatenate([rounded @ frame for frame in self.frames]),
            np.concatenate([triangles + face * len(plane) for face in range(FACES)]).astype(np.int32),
            np.concatenate(uv),
        )

    def _steps(self) -> Float64:
        """Grid lines of a face, all of them within the rounded rims but two."""
        inner = self.half_m - self.corner_radius_m
        rim = np.linspace(inner, self.half_m, _GRID // 2)
        return np.concatenate([-rim[::-1], rim])

    def uppermost(self, q: Float64, up: Sequence[float]) -> NDArray[np.int64]:
        """The face, 1 to 6, that looks most towards `up` (3,), in the frame that `q` (..., 4) maps to."""
        seen = geometry.rotate(geometry.conjugate(q), np.asarray(up, np.float64))
        return np.argmax(seen @ self.normals.T, axis=-1) + 1

    def turned(self, face: int, towards: Sequence[float], start: Sequence[float]) -> Float64:
        """The rotation (4,) nearest to `start` (4,) with which `face` looks towards a direction (3,)."""
        q, wanted = np.array(start, np.float64), np.array(towards, np.float64)
        return geometry.multiply(_shortest(geometry.rotate(q, self.normals[face - 1]), wanted, q), q)

    def turns(self, face: int, towards: Sequence[float], start: Sequence[float], count: int) -> Float64:
        """Rotations (count, 4), the first as from `turned`, the others evenly about that direction."""
        axis = np.broadcast_to(np.array(towards, np.float64), (count, 3))
        about = geometry.from_axis_angle(axis, np.arange(count) * (2 * math.pi / count))
        first = self.turned(face, towards, start)
        return geometry.multiply(about, np.broadcast_to(first, (count, 4)))


DIE = Die()


def _cube_rotations() -> Float64:
    """Signed permutation matrices of determinant 1, the identity first."""
    signed = [
        np.diag(signs)[list(order)]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    return np.stack([matrix for matrix in signed if np.linalg.det(matrix) > 0])


# The rotations (24, 3, 3) that map the bare cube onto itself, the identity first. A pose R that is right but
# for its face labels is one of R · CUBE_ROTATIONS[l].
CUBE_ROTATIONS = _cube_rotations()


def _luminance(rgb: Rgb) -> float:
    """Rec. 601, as in OpenCV's conversion to grey."""
    return float(np.dot((0.299, 0.587, 0.114), rgb))


def _shortest(source: Float64, target: Float64, q: Float64) -> Float64:
    """The shortest turn (4,) from direction `source` to `target`; half a turn goes about an axis of `q`."""
    target = target / np.linalg.norm(target)
    axis = np.cross(source, target)
    cosine = float(np.clip(source @ target, -1.0, 1.0))
    if np.linalg.norm(axis) < 1e-9:
        sides = geometry.rotate(np.broadcast_to(q, (3, 4)), np.eye(3))
        axis = sides[np.argmin(np.abs(sides @ target))]
    return geometry.from_axis_angle(axis, np.array(math.acos(cosine)))


def _grid_triangles(side: int) -> NDArray[np.int32]:
    """Two triangles for each cell of a grid of `side` x `side` points, numbered row by row: (T, 3)."""
    first = np.add.outer(side * np.arange(side - 1), np.arange(side - 1)).ravel()[:, None]
    halves = np.array([[0, 1, side + 1], [0, side + 1, side]])
    return np.concatenate([first + half for half in halves]).astype(np.int32)
