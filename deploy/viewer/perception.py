"""Draws what perception sees and says: pictures, state, quality, labels, and its poses beside the truth."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from typing import Any

import numpy as np

from common import geometry
from common.camera_messages import CameraPreview, PoseState, PoseTracking, TwinTruth
from common.hand_messages import ObjectPose
from common.messages import Message, Sample
from deploy.viewer.curves import GREY, LIGHT_BLUE, MM, ORANGE, RED, WHITE, Curves, Rgb
from deploy.viewer.drawing import Bars, Drawing, Picture, State, When, event, scalars

KEPT = 64  # truths that wait for a pose of the same moment, and poses for a truth
LANE = "state/perception"
LANE_RGB: dict[str, Rgb] = {
    PoseState.SEARCHING: (120, 120, 130),
    PoseState.TRACKING: (60, 160, 95),
    PoseState.SUSPECT: (225, 150, 50),
    PoseState.LOST: (210, 70, 70),
}


def perception_curves() -> tuple[Curves, ...]:
    """Legends and colours of what is drawn here."""
    quality = ("consistent", "occluded", "violated", "pip correlation")
    return (
        Curves("perception/quality", quality, ((90, 220, 110), GREY, RED, LIGHT_BLUE)),
        Curves("perception/latency_ms", ("capture to pose", "backend"), (ORANGE, LIGHT_BLUE)),
        Curves("perception/error_mm/claimed", ("position, claimed",), (WHITE,)),
        Curves("perception/error_mm/unclaimed", ("position, not claimed",), (RED,), 1.5, "points"),
        Curves("perception/error_deg/claimed", ("rotation, claimed",), (WHITE,)),
        Curves("perception/error_deg/unclaimed", ("rotation, not claimed",), (RED,), 1.5, "points"),
        Curves(
            "perception/position_mm/told", ("x", "y", "z"), ((255, 120, 120), (120, 230, 130), LIGHT_BLUE)
        ),
        Curves("perception/position_mm/true", ("x true", "y true", "z true"), (GREY, GREY, GREY), 1.0),
    )


class PerceptionDrawer:
    """Turns the messages of camera and perception into drawings.

    A pose and the truth of the same moment have the same capture time; whichever comes first waits.
    """

    def __init__(self) -> None:
        self._truths: OrderedDict[int, TwinTruth] = OrderedDict()
        self._poses: OrderedDict[int, tuple[ObjectPose, bool]] = OrderedDict()
        self._said: tuple[str, str] = ("", "")

    def draw(self, sample: Sample, when: When) -> Iterator[Drawing]:
        """What a message shows; nothing for messages of others."""
        message: Message = sample.message
        t_ns = sample.header.t_ns
        if isinstance(message, CameraPreview):
            yield Drawing("perception/colour", when, Picture(message.colour_jpeg))
            yield Drawing("perception/depth", when, Picture(message.depth_jpeg))
        elif isinstance(message, PoseTracking):
            yield from self._tracking(message, when)
        elif isinstance(message, ObjectPose):
            yield scalars("perception/position_mm/told", when, MM * message.position.astype(np.float64))
            _keep(self._poses, t_ns, (message, sample.header.valid))
            yield from self._compare(t_ns, when)
        elif isinstance(message, TwinTruth):
            yield scalars("perception/position_mm/true", when, MM * message.position.astype(np.float64))
            _keep(self._truths, t_ns, message)
            yield from self._compare(t_ns, when)

    def _tracking(self, message: PoseTracking, when: When) -> Iterator[Drawing]:
        if message.frame_number:
            yield scalars("perception/latency_ms", when, [message.latency_ms, message.solve_ms])
        if message.label_posterior.any():
            yield scalars("perception/quality", when, message.quality)
            yield Drawing("perception/labels", when, Bars(message.label_posterior.astype(np.float64)))
        said = message.state.value, _kind(message.message)
        if said != self._said:
            changed, self._said = said[0] != self._said[0], said
            if changed:
                yield Drawing(LANE, when, State(message.state))
            text = f"{message.state.value}: {message.message}" if message.message else message.state.value
            yield event("perception", when, text, "WARN" if message.message else "INFO")

    def _compare(self, t_ns: int, when: When) -> Iterator[Drawing]:
        """How far a pose is from the truth of its moment: mm and degrees."""
        if t_ns not in self._truths or t_ns not in self._poses:
            return
        truth, (pose, valid) = self._truths[t_ns], self._poses.pop(t_ns)
        kind = "claimed" if valid else "unclaimed"
        distance = np.linalg.norm(pose.position.astype(np.float64) - truth.position)
        rotations = (geometry.normalise(q.astype(np.float64)) for q in (pose.rotation, truth.rotation))
        yield scalars(f"perception/error_mm/{kind}", when, MM * distance)
        yield scalars(f"perception/error_deg/{kind}", when, np.degrees(geometry.angle(*rotations)))


def _kind(text: str) -> str:
    """A message without its numbers, which change all the time."""
    return "".join(character for character in text if not character.isdigit())


def _keep(kept: OrderedDict[int, Any], key: int, value: Any) -> None:
    kept[key] = value
    while len(kept) > KEPT:
        kept.popitem(last=False)
