"""The whole way from messages to what people see; slow parts are called from a worker."""

from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from common.cell import SharedConfig
from common.messages import Sample
from common.task import DieTask
from deploy.viewer.blueprint import dashboard
from deploy.viewer.config import ViewerConfig
from deploy.viewer.control import GHOST
from deploy.viewer.curves import LANES, curves_of
from deploy.viewer.drawer import Drawer
from deploy.viewer.hand_curves import HAND_LANE, force_arrows, hand_curves
from deploy.viewer.perception import LANE, LANE_RGB, perception_curves
from deploy.viewer.recording import Recording, file_sink, server_sink
from deploy.viewer.web import WebPage
from services.sim.kinematics import SceneKinematics

# Drawings, some 15 s of them: what a crash loses of the file, and the bus logs still have. With 2000, rerun's
# index of the file grows by 400 MB of memory an hour.
FILE_BATCH = 10_000
log = logging.getLogger(__name__)


class Dashboard:
    """Draws samples to a file, to browsers, or both."""

    def __init__(
        self, shared: SharedConfig, config: ViewerConfig, driven: bool = False, watched: bool = False
    ) -> None:
        self._shared = shared
        self._config = config
        self._driven = driven  # the hand is one on a bus
        self._watched = watched  # by a camera
        self._lock = threading.Lock()  # `close` comes from another thread than `draw`
        self._drawer: Drawer | None = None
        self._recordings: list[Recording] = []
        self._page: WebPage | None = None

    @property
    def url(self) -> str:
        """Where to look; empty while nothing is served."""
        return self._page.url if self._page else ""

    def open(self) -> None:
        """Build the scene, begin file and server; takes a second. Raises OSError without either."""
        with self._lock:
            kinematics = SceneKinematics(self._shared.task)
            self._begin_recordings()
            pages = Pages(self._driven, self._watched)
            for recording in self._recordings:
                arrange(recording, kinematics, self._shared, self._config.ghost, pages)
            self._drawer = Drawer(kinematics, self._shared.control.period_ns, self._config.ghost)

    def _begin_recordings(self) -> None:
        path = next_path(self._shared.run_dir)
        name = f"{self._shared.run_dir.name}-{path.stem}"
        if self._config.save:
            self._recordings.append(Recording(name, file_sink(path), FILE_BATCH))
        if self._config.serve and self._ports_free():
            bind, port = self._config.bind, self._config.grpc_port
            sink = server_sink(bind, port, self._config.memory_limit_mb)
            self._recordings.append(Recording(name, sink))
            self._page = WebPage(bind, self._config.web_port, port)
        if not self._recordings:
            raise OSError("nothing to draw to: no file is wanted and the dashboard's ports are in use")

    def _ports_free(self) -> bool:
        """Whether the dashboard can be served; rerun itself would fail later, and silently."""
        for port in (self._config.grpc_port, self._config.web_port):
            if not _free(self._config.bind, port):
                log.warning("port %d is in use: no live dashboard; the recording goes on", port)
                return False
        return True

    def draw(self, samples: Iterable[Sample]) -> None:
        """Draw samples in the order given. Raises RuntimeError if it is not open."""
        with self._lock:
            if self._drawer is None:
                raise RuntimeError("the dashboard is not open")
            drawings = [drawing for sample in samples for drawing in self._drawer.draw(sample)]
            for recording in self._recordings:
                recording.add(drawings)

    def close(self) -> None:
        """Finish the file and end the server, within the configured time."""
        if not self._lock.acquire(timeout=self._config.flush_s):
            log.warning("a drawing is stuck: the end of the recording is lost")
            return
        try:
            self._close()
        finally:
            self._lock.release()

    def _close(self) -> None:
        if self._page is not None:
            self._page.close()
        for recording in self._recordings:
            try:
                recording.close(self._config.flush_s)
            except RuntimeError as error:
                log.warning("the end of a recording is lost: %s", error)
        self._drawer, self._page, self._recordings = None, None, []


@dataclass(frozen=True)
class Pages:
    """What a cell has to show: a hand that is driven over a bus, and one that a camera watches."""

    driven: bool
    watched: bool


def arrange(
    recording: Recording, kinematics: SceneKinematics, shared: SharedConfig, ghost: bool, pages: Pages
) -> None:
    """Put facts, layout, legends and meshes into a new recording."""
    facts = {"cell": shared.cell, "task": shared.task, "seed": str(shared.seed)}
    if shared.config_hash:
        facts["config_hash"] = shared.config_hash
    recording.describe(f"{shared.cell} {shared.run_dir.name}", facts)
    recording.lay_out(dashboard(kinematics.task, pages.driven, pages.watched))
    recording.name_curves(curves_of(kinematics.task))
    for path, colours in LANES.items():
        recording.colour_states(path, colours)
    recording.place_scene(kinematics.scene(), GHOST if ghost else "")
    if isinstance(kinematics.task, DieTask):
        recording.name_curves(hand_curves())
        recording.colour_states("state/hand", HAND_LANE)
        recording.place_arrows(force_arrows())
        recording.name_curves(perception_curves())
        recording.colour_states(LANE, LANE_RGB)


def next_path(run_dir: Path) -> Path:
    """The first `recording-<n>.rrd` that does not exist: a restart never overwrites."""
    number = 0
    while (path := run_dir / f"recording-{number}.rrd").exists():
        number += 1
    return path


def _free(bind: str, port: int) -> bool:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((bind, port))
        except OSError:
            return False
    return True
