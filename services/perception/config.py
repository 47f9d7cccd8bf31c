"""Options of perception."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from common.camera_config import CameraConfig
from common.cell import SharedConfig
from common.config import Frozen
from services.perception.calibration import Dictionary
from services.perception.filter import FilterConfig
from services.perception.last_place import ElsewhereConfig
from services.perception.screen import ScreenConfig
from services.perception.status import SilenceConfig


class SourceConfig(Frozen):
    """A camera, or what stands in for one."""

    kind: Literal["bus", "realsense", "recording"] = Field(
        default="bus",
        description="bus: camera/frame, of an emulated hand; realsense: a camera of this machine; recording",
    )
    path: Path | None = Field(
        default=None, description="of the recording: a folder, or a .bag or .db3 of the RealSense SDK"
    )
    repeat: bool = Field(default=False, description="begin a folder's recording again at its end")
    serial: str = Field(default="", description="which RealSense; empty: the first one found")
    width: int = Field(default=640, gt=0, description="px, of a RealSense")
    height: int = Field(default=480, gt=0, description="px")
    rate_hz: int = Field(default=60, gt=0, description="pictures a second; its modes know 30 and 60")


class ReachConfig(Frozen):
    """A ball in the palm's frame."""

    centre_m: tuple[float, float, float] = Field(default=(0.06, 0.0, 0.12), description="in the palm's frame")
    radius_m: float = Field(default=0.15, gt=0.0, description="a die is searched within it")
    believed_m: float = Field(default=0.5, gt=0.0, description="and followed as far as this from the centre")


class KnockConfig(Frozen):
    """How closely the camera's place is watched."""

    period_s: float = Field(default=1.0, gt=0.0, description="between two looks at the palm's tag")
    limit_px: float = Field(default=2.0, gt=0.0, description="a tag further off means a knocked camera")
    looks: int = Field(default=3, ge=1, description="so many in a row decide")
    unseen_looks: int = Field(
        default=60,
        ge=1,
        description="without the tag, and no pose is claimed until it is seen again; 30 s at preview_hz 2: "
        "longer than the fingers of one episode hide it",
    )


class CubeConfig(Frozen):
    """The marker cube; its edge is the die's."""

    dictionary: Dictionary = "DICT_4X4_50"
    first: int = Field(default=1, ge=0, description="number of face 1's marker; the others follow")
    marker_m: float = Field(default=0.044, gt=0.0, description="side of a marker's black square")


class FoundationPoseConfig(Frozen):
    """A FoundationPose that somebody installed; research and evaluation only (NVIDIA Source Code License)."""

    python: Path = Field(default=Path("python3"), description="of the environment with CUDA and torch")
    repository: Path = Field(default=Path("FoundationPose"), description="a checkout, with its weights")
    open_s: float = Field(default=120.0, gt=0.0, description="longest wait for weights and mesh to be loaded")
    register_s: float = Field(default=20.0, gt=0.0, description="and for a first pose")
    track_s: float = Field(default=2.0, gt=0.0, description="and for each further one")


class Sam6dConfig(Frozen):
    """A SAM-6D that somebody installed, for the mask of a search."""

    python: Path = Field(default=Path("python3"), description="of its environment")
    repository: Path = Field(default=Path("SAM-6D/SAM-6D"), description="the folder with its three parts")
    templates: Path = Field(default=Path("templates"), description="42 views of the die that its Render made")
    min_score: float = Field(default=0.4, ge=0.0, le=1.0, description="a mask below it is not used")
    timeout_s: float = Field(default=120.0, gt=0.0, description="longest wait for a mask")


class PerceptionConfig(Frozen):
    """Which camera is read, who finds the die in its pictures, and what is believed of that."""

    source: SourceConfig = SourceConfig()
    calibration: Path | None = Field(
        default=None, description="file of services.perception.calibrate; none: the emulated camera's place"
    )
    backend: Literal["cpu", "foundationpose", "aruco"] = Field(default="cpu", description="who finds the die")
    foundationpose: FoundationPoseConfig = FoundationPoseConfig()
    mask: Literal["reach", "sam6d"] = Field(
        default="reach", description="where a search looks: within the hand's reach, or where SAM-6D says"
    )
    sam6d: Sam6dConfig = Sam6dConfig()
    aruco: CubeConfig = CubeConfig()
    die: str = Field(
        default="white", description="a name in common.dice, or a file of services.perception.onboard"
    )
    screen: ScreenConfig = ScreenConfig()
    silence: SilenceConfig = SilenceConfig()
    filter: FilterConfig = FilterConfig()
    elsewhere: ElsewhereConfig = ElsewhereConfig()
    reach: ReachConfig = ReachConfig()
    knock: KnockConfig = KnockConfig()
    search_pause_s: float = Field(
        default=0.0, ge=0.0, description="between two searches; 0: most of a core while the die is not seen"
    )
    preview_hz: float = Field(default=2.0, ge=0.0, le=5.0, description="pictures for the dashboard; 0: none")
    declared_track_ms: float = Field(default=6.0, ge=0.0, description="lock-step only")
    declared_register_ms: float = Field(default=200.0, ge=0.0, description="lock-step only")


class PerceptionProcess(SharedConfig):
    """What the perception process is started with."""

    perception: PerceptionConfig = PerceptionConfig()
    camera: CameraConfig = CameraConfig()
