"""Drawings → Rerun: one recording that goes to a file, to browsers, or both."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from deploy.viewer.curves import TO_GOAL, Arrows, Curves, Rgb
from deploy.viewer.drawing import (
    Arrow,
    Bars,
    Drawing,
    Event,
    Picture,
    Poses,
    Scalars,
    Segments,
    State,
    When,
)
from services.sim.scene import Scene, SceneMesh

APPLICATION = "gc-pmpc"
WORLD = "world"
GHOST_RGBA = (110, 170, 255, 70)
POINT_SCALE = 1.3  # a mark's size, for a line's width of one
SEGMENT_RADIUS_M = 0.0008
ARROW_RADIUS_M = 0.0018


class Recording:
    """A Rerun recording under way. All methods may be called from any one thread at a time.

    Drawings are handed to Rerun when `batch` of them have gathered: each hand-over costs a kilobyte per
    entity, so a file written ten times a second would hold little else.
    """

    def __init__(self, recording_id: str, sink: Any, batch: int = 1) -> None:
        """Begin with one of rerun's sinks. Raises RuntimeError if it cannot be opened."""
        self._stream = rr.RecordingStream(APPLICATION, recording_id=recording_id)
        self._stream.set_sinks(sink)
        self._batch = batch
        self._pending: list[Drawing] = []

    def describe(self, name: str, facts: dict[str, str]) -> None:
        """Name the recording and attach facts for the selection panel."""
        self._stream.send_recording_name(name)
        self._stream.send_property("run", rr.AnyValues(False, **facts))

    def lay_out(self, blueprint: rrb.Blueprint) -> None:
        """Lay out the dashboard."""
        self._stream.send_blueprint(blueprint)

    def place_scene(self, scene: Scene, ghost_prefix: str) -> None:
        """Add the meshes once; a transparent copy of hand and object if `ghost_prefix` is not empty."""
        for path in (WORLD, TO_GOAL):
            self._static(path, rr.CoordinateFrame(WORLD))
        for body in scene.bodies:
            for number, mesh in enumerate(body.meshes):
                path = f"{WORLD}/scene/{body.name}/{number}"
                self._static(path, _mesh(mesh, _bytes(mesh.rgba)), rr.CoordinateFrame(body.name))
                if ghost_prefix and not body.name.startswith("goal"):
                    path = f"{WORLD}/ghosts/{body.name}/{number}"
                    frame = rr.CoordinateFrame(ghost_prefix + body.name)
                    self._static(path, _mesh(mesh, GHOST_RGBA), frame)

    def place_arrows(self, arrows: Iterable[Arrows]) -> None:
        """Tell in which body's frame the arrows of an entity are, and their colour."""
        for item in arrows:
            style = rr.Arrows3D.from_fields(radii=[ARROW_RADIUS_M], colors=[item.colour])
            self._static(item.path, style, rr.CoordinateFrame(item.body))

    def name_curves(self, curves: Iterable[Curves]) -> None:
        """Give curves their legends and colours."""
        for item in curves:
            style = {"names": list(item.names), "colors": list(item.colours) or None}
            marks: list[Any] = []
            if item.marks != "points":
                marks.append(rr.SeriesLines(**style, widths=item.width))
            if item.marks != "lines":
                marks.append(rr.SeriesPoints(**style, marker_sizes=POINT_SCALE * item.width))
            self._static(item.path, *marks)

    def colour_states(self, path: str, colours: Mapping[str, Rgb]) -> None:
        """Give the states of one lane their colours."""
        values, rgb = list(colours), list(colours.values())
        self._static(path, rr.StateConfiguration(values=values, labels=values, colors=rgb))

    def _static(self, path: str, *values: Any) -> None:
        self._stream.log(path, *values, static=True)

    def add(self, drawings: Iterable[Drawing]) -> None:
        """Add drawings; they are sent when there are enough."""
        self._pending += drawings
        if len(self._pending) >= self._batch:
            self._send()

    def _send(self) -> None:
        """One call to Rerun per entity, however many moments it covers."""
        grouped: dict[tuple[str, type, int], list[Drawing]] = {}
        for drawing in self._pending:
            size = drawing.value.values.size if isinstance(drawing.value, Scalars) else 0
            grouped.setdefault((drawing.path, type(drawing.value), size), []).append(drawing)
        self._pending = []
        for (path, kind, _), group in grouped.items():
            if kind is Bars:
                self._log_bars(path, group)
                continue
            repeats, columns = _COLUMNS[kind]([drawing.value for drawing in group])
            indexes = _times([drawing.when for drawing in group], repeats)
            self._stream.send_columns(path, indexes=indexes, columns=columns)

    def _log_bars(self, path: str, group: list[Drawing]) -> None:
        """One call for each: Rerun takes no columns of tensors."""
        for drawing in group:
            assert isinstance(drawing.value, Bars)
            self._stream.set_time("step", sequence=drawing.when.step)
            self._stream.set_time("time", timestamp=np.datetime64(drawing.when.t_ns, "ns"))
            self._stream.set_time("episode", sequence=drawing.when.episode)
            self._stream.log(path, rr.BarChart(drawing.value.values))
        self._stream.reset_time()

    def close(self, timeout_s: float) -> None:
        """Write what is left and end file or server. Raises RuntimeError after `timeout_s`."""
        try:
            self._send()
            self._stream.flush(timeout_sec=timeout_s)
        finally:
            self._stream.disconnect()


def _times(moments: list[When], repeats: list[int]) -> list[rr.TimeColumn]:
    stamps = np.repeat(np.array([when.t_ns for when in moments], "datetime64[ns]"), repeats)
    steps = np.repeat([when.step for when in moments], repeats)
    episodes = np.repeat([when.episode for when in moments], repeats)
    return [
        rr.TimeColumn("step", sequence=steps),
        rr.TimeColumn("time", timestamp=stamps),
        rr.TimeColumn("episode", sequence=episodes),
    ]


def _scalar_columns(values: list[Scalars]) -> tuple[list[int], Any]:
    return [1] * len(values), rr.Scalars.columns(scalars=np.stack([value.values for value in values]))


def _pose_columns(values: list[Poses]) -> tuple[list[int], Any]:
    """One row per frame: all bodies of all moments travel in a single call."""
    frames = [frame for value in values for frame in value.frames]
    quaternions = np.concatenate([value.quaternions for value in values])
    columns = rr.Transform3D.columns(
        translation=np.concatenate([value.positions for value in values]),
        quaternion=np.roll(quaternions, -1, axis=1),  # Rerun's order is xyzw
        child_frame=frames,
        parent_frame=[WORLD] * len(frames),
    )
    return [len(value.frames) for value in values], columns


def _segment_columns(values: list[Segments]) -> tuple[list[int], Any]:
    strips = [strip for value in values for strip in value.points]
    colours = [colour for value in values for colour in value.colours]
    radii = [SEGMENT_RADIUS_M] * len(strips)
    columns = rr.LineStrips3D.columns(strips=strips, radii=radii, colors=colours)
    return [1] * len(values), columns.partition([len(value.points) for value in values])


def _arrow_columns(values: list[Arrow]) -> tuple[list[int], Any]:
    vectors, origins = (np.stack([getattr(v, name) for v in values]) for name in ("vector", "origin"))
    return [1] * len(values), rr.Arrows3D.columns(vectors=vectors, origins=origins)


def _picture_columns(values: list[Picture]) -> tuple[list[int], Any]:
    blobs = [value.data for value in values]
    return [1] * len(values), rr.EncodedImage.columns(blob=blobs, media_type=["image/jpeg"] * len(values))


def _state_columns(values: list[State]) -> tuple[list[int], Any]:
    return [1] * len(values), rr.StateChange.columns(state=[value.label for value in values])


def _event_columns(values: list[Event]) -> tuple[list[int], Any]:
    columns = rr.TextLog.columns(text=[v.text for v in values], level=[v.level for v in values])
    return [1] * len(values), columns


_COLUMNS: dict[type, Callable[[Any], tuple[list[int], Any]]] = {
    Scalars: _scalar_columns,
    Poses: _pose_columns,
    Segments: _segment_columns,
    Arrow: _arrow_columns,
    Picture: _picture_columns,
    State: _state_columns,
    Event: _event_columns,
}


def _mesh(mesh: SceneMesh, rgba: tuple[int, ...]) -> rr.Mesh3D:
    return rr.Mesh3D(
        vertex_positions=mesh.vertices,
        triangle_indices=mesh.triangles,
        vertex_normals=vertex_normals(mesh),
        albedo_factor=list(rgba),
    )


def vertex_normals(mesh: SceneMesh) -> NDArray[np.float32]:
    """Unit normals (V, 3), the mean of the touching triangles by area: without them nothing is shaded."""
    first, second, third = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    faces = np.cross(second - first, third - first)
    sums = np.zeros_like(mesh.vertices)
    for corner in range(3):
        np.add.at(sums, mesh.triangles[:, corner], faces)
    return sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), np.finfo(np.float32).tiny)


def _bytes(rgba: Any) -> tuple[int, ...]:
    return tuple(round(255 * float(channel)) for channel in rgba)


def file_sink(path: Path) -> Any:
    """A file that survives a crash of the process; only its index is missing then."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return rr.FileSink(path)


def server_sink(bind: str, port: int, memory_limit_mb: int) -> Any:
    """A server for browsers that keeps the newest data for those that open late."""
    return rr.GrpcServerSink(bind, port, server_memory_limit=f"{memory_limit_mb}MB")
