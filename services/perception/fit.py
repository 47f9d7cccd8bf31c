"""From a recording of the plate to a calibration file's content."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from services.perception import rigid
from services.perception.calibration import Calibration, Case, Pose, TagReference
from services.perception.frames import Float64, Frame, FrameSource, Refused
from services.perception.plate import Plate, View
from services.perception.rig import RigConfig
from services.perception.solve import Solved, SolveError, solve_hand_eye, solve_jig, solve_robot_world
from services.perception.tags import TagFinder

MIN_TAG_FRAMES = 3


@dataclass(frozen=True)
class Views:
    """A recording as the plate's detector sees it."""

    found: dict[int, View]  # by number of the frame within the recording
    refused: list[str]  # a line for each frame without a usable view
    camera_matrix: Float64
    image_size: tuple[int, int]  # width, height


def frames_of(source: FrameSource) -> Iterator[Frame | Refused]:
    """What a recording holds, to its end."""
    while True:
        read = source.read(0.0)
        if isinstance(read, Refused) and read.reason == "ended":
            return
        yield read


def read_views(source: FrameSource, rig: RigConfig) -> Views:
    """Look for the plate in each frame of a recording. Raises SolveError for one without a frame."""
    plate = Plate(rig.plate)
    found: dict[int, View] = {}
    refused: list[str] = []
    first: Frame | None = None
    for number, frame in enumerate(frames_of(source)):
        if isinstance(frame, Refused):
            refused.append(f"view {number + 1}: {frame.message}")
            continue
        first = first or frame
        view = plate.look(frame.colour, frame.camera_matrix)
        if isinstance(view, View):
            found[number] = view
        else:
            refused.append(f"view {number + 1}: {view}")
    if first is None:
        raise SolveError("the recording holds no frame")
    height, width = first.depth.shape
    return Views(found, refused, first.camera_matrix, (width, height))


def fit(rig: RigConfig, views: Views, case: Case, arm: list[Float64], tag_frames: FrameSource) -> Calibration:
    """Calibrate from views of the plate and, with an arm, `T_base_palm` (4, 4) of each. Raises SolveError."""
    solved, T_palm_camera = _solved(rig, views, case, arm)
    fx, fy, cx, cy = (float(views.camera_matrix[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Calibration(
        serial=rig.serial,
        date=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        case=case,
        image_size=views.image_size,
        camera_matrix=((fx, 0.0, cx), (0.0, fy, cy), (0.0, 0.0, 1.0)),
        camera_in_palm=Pose.of(T_palm_camera),
        residuals=solved.residuals,
        tag=tag_reference(rig, tag_frames),
    )


def _solved(rig: RigConfig, views: Views, case: Case, arm: list[Float64]) -> tuple[Solved, Float64]:
    """The solution, and `T_palm_camera` (4, 4)."""
    plate, found = Plate(rig.plate), list(views.found.values())
    if case == "jig":
        if rig.jig is None:
            raise SolveError("the rig file has no jig: where is the plate in the palm's frame?")
        solved = solve_jig(found, plate, views.camera_matrix, rig.jig.transform)
        return solved, solved.T_frame_camera
    if len(arm) != len(views.found) + len(views.refused):
        seen = len(views.found) + len(views.refused)
        raise SolveError(f"{len(arm)} poses of the palm for {seen} views: one for each wanted")
    poses = [arm[number] for number in views.found]
    if case == "hand_eye":
        solved = solve_hand_eye(found, poses, plate, views.camera_matrix)
        return solved, solved.T_frame_camera
    if rig.home is None:
        raise SolveError("the rig file has no home: where is the palm in the arm's base while it works?")
    solved = solve_robot_world(found, poses, plate, views.camera_matrix)
    return solved, rigid.inverse(rig.home.transform) @ solved.T_frame_camera


def tag_reference(rig: RigConfig, frames: FrameSource) -> TagReference | None:
    """Where the palm's tag is in the pictures: the median over frames; None if too few show it."""
    if rig.tag is None:
        return None
    finder = TagFinder(rig.tag.dictionary)
    seen = [
        tag.pixels
        for frame in frames_of(frames)
        if isinstance(frame, Frame)
        for tag in finder.find(frame.colour)
        if tag.number == rig.tag.number
    ]
    if len(seen) < MIN_TAG_FRAMES:
        return None
    corners = [(x, y) for x, y in np.median(seen, axis=0).tolist()]
    return TagReference(dictionary=rig.tag.dictionary, number=rig.tag.number, corners_px=tuple(corners))
