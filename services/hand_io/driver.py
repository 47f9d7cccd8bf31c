"""The hand as a device: a thread that sends set points, one that reads, and a bus that may come and go."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import Counter, deque
from collections.abc import Callable

import numpy as np

from common.can_config import CanConfig
from common.can_link import BadFrame, BusOff, Busy, CanLink, LinkError
from common.clock import Clock, Ticker, WallClock
from common.dexhand021 import host
from common.dexhand021.commands import Command
from common.dexhand021.config import DexHandConfig
from common.dexhand021.frames import Reason, Refusal
from common.dexhand021.replies import Reply
from common.dexhand021.tables import BOARDS
from common.hand_messages import Drive, HandCommand, HandFrame, Link
from common.messages import Message
from common.topics import HAND_FRAME, Topic
from services.hand_io.boards import Boards
from services.hand_io.config import HandIoConfig
from services.hand_io.hand_frame import hand_frame
from services.hand_io.set_points import SetPoints

NS_PER_S = 1e9
READ_TIMEOUT_S = 0.1
RETRY_S = 0.001  # before a frame that found no room is tried once more
BUSY_CYCLES = 50  # in a row: this adapter does not send any more
ROUND_TRIPS = 512  # that quantiles are taken over
STATISTICS_EVERY = 25  # cycles
PARTING_FRAMES = 3  # without torque, at the end: any one of them suffices
Open = Callable[[CanConfig, bool], CanLink]


class HandPort:
    """Drives one hand at `set_point_hz`; each cycle it delivers what it knows as a HandFrame.

    The state of the bus, the boards and the set points is guarded by one lock; sending and receiving
    happen outside of it.
    """

    name = "hand"

    def __init__(
        self,
        can: CanConfig,
        hand: DexHandConfig,
        config: HandIoConfig,
        open_link: Open = CanLink,
        clock: Clock | None = None,
    ) -> None:
        self._can, self._hand, self._config = can, hand, config
        self._open_link = open_link
        self._clock = clock or WallClock()
        self._deliver: Callable[[Topic, Message], None] = lambda _topic, _message: None
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._answered = threading.Event()  # by all boards, in this cycle
        self._thread = threading.Thread(target=self._run, name="hand sender", daemon=True)
        clear_ns, max_clear_ns = _ns(config.clear_s), _ns(config.max_clear_s)
        resume_c, rest_ns = config.limits.resume_c, _ns(config.recover_s)
        self._boards = Boards(hand, clear_ns, max_clear_ns, resume_c, rest_ns)
        self._points = SetPoints(config.limits, hand, _ns(config.hold_s))
        self._link: CanLink | None = None
        self._state = Link.DOWN
        self._reopen_ns = 0  # when a lost bus is opened again
        self._pause_ns = _ns(config.reopen_s)
        self._lost = False  # and nobody has taken note of it yet
        self._busy = 0  # cycles in a row
        self._sent_ns = 0
        self._waiting: set[int] = set()  # boards that have not answered the present cycle
        self._round_trips_ms: deque[float] = deque(maxlen=ROUND_TRIPS)
        self._statistics: dict[str, float] = {}
        self._counts: Counter[str] = Counter()
        self.last_error = ""

    # --- as a port --------------------------------------------------------------------------------

    def open(self, deliver: Callable[[Topic, Message], None]) -> None:
        """Start to look for the hand; no motor has torque until a command says so."""
        self._deliver = deliver
        self._thread.start()

    def write(self, message: Message) -> None:
        """Take over a command; it takes effect with the next frame sent.

        Without a bus, and after a loss until its sender has answered that with OFF, everything else is
        refused: it was meant for the time before.
        """
        if not isinstance(message, HandCommand):
            raise TypeError(f"the hand takes HandCommand, got {type(message).__name__}")
        with self._lock:
            if message.drive is Drive.OFF:
                self._lost = False
            elif self._link is None or self._lost:
                self._counts["refused_commands"] += 1
                return
            self._points.command(self._clock.now_ns(), message, self._boards.sensed())

    def close(self) -> None:
        """Take the torque off and leave the bus."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        with self._lock:
            self._points.release()
        link, self._link = self._link, None
        if link is not None:
            for _ in range(PARTING_FRAMES):
                with contextlib.suppress(Busy, BusOff, LinkError):
                    self._send(link, self._next_commands(self._clock.now_ns()))
            link.close()

    # --- sending ----------------------------------------------------------------------------------

    def _run(self) -> None:
        ticker = Ticker(round(NS_PER_S / self._config.set_point_hz), self._clock.now_ns())
        while not self._stop.wait(max(0.0, (ticker.next_ns - self._clock.now_ns()) / NS_PER_S)):
            now_ns = self._clock.now_ns()
            skipped = ticker.take(now_ns) - 1
            with self._lock:
                self._counts["skipped_cycles"] += max(0, skipped)
            self._answered.clear()
            self._cycle(now_ns)
            self._answered.wait(0.5 / self._config.set_point_hz)  # so that what is told is fresh
            self._deliver(HAND_FRAME, self._frame())

    def _cycle(self, now_ns: int) -> None:
        """Send one round of set points, or try to get the bus back."""
        link = self._link
        if link is None:
            self._reopen(now_ns)
            return
        commands = self._next_commands(now_ns)
        try:
            self._send(link, commands)
            self._busy = 0
        except Busy as error:
            self._note_busy(link, str(error))
        except BusOff:
            self._lose(link, Link.BUS_OFF, "bus off")
        except LinkError as error:
            self._lose(link, Link.DOWN, str(error))

    def _next_commands(self, now_ns: int) -> list[Command]:
        with self._lock:
            clears = self._boards.clears(now_ns)
            silent = self._boards.age_ns(now_ns) > _ns(self._config.stale_ms / 1e3)
            lost = np.repeat(silent | self._boards.take_restarted(), 2)
            if self._boards.overheated.any():
                self._points.release()  # at once, whatever the service will say
            self._points.step(now_ns, self._boards.sensed(), lost)
            self._begin_cycle(now_ns)
            return [*clears, *self._points.commands()]

    def _begin_cycle(self, now_ns: int) -> None:
        """Account for the last cycle: the answers that are missing now do not come any more."""
        self._counts["cycles"] += 1
        # Its set points are in the next frame again: nothing has to be repeated, and ages tell the rest.
        self._counts["late_cycles"] += bool(self._waiting) and self._sent_ns > 0
        self._sent_ns, self._waiting = now_ns, set(range(len(BOARDS)))
        if self._counts["cycles"] % STATISTICS_EVERY == 0 and self._round_trips_ms:
            p50, p99 = np.percentile(self._round_trips_ms, (50, 99))
            self._statistics = {"round_trip_ms_p50": float(p50), "round_trip_ms_p99": float(p99)}

    def _send(self, link: CanLink, commands: list[Command]) -> None:
        for command in commands:
            frame = host.encode(command)
            try:
                link.send(frame)
            except Busy:
                time.sleep(RETRY_S)
                link.send(frame)

    def _note_busy(self, link: CanLink, why: str) -> None:
        self._busy += 1
        with self._lock:
            self._counts["busy"] += 1
        if self._busy >= BUSY_CYCLES:
            self._lose(link, Link.DOWN, f"nothing can be sent: {why or 'the queue stays full'}")

    # --- the bus comes and goes -------------------------------------------------------------------

    def _reopen(self, now_ns: int) -> None:
        if now_ns < self._reopen_ns:
            return
        try:
            link = self._open_link(self._can, self._hand.bit_rate_switch)
        except LinkError as error:
            self.last_error = str(error)
            self._retry_later(now_ns)
            return
        with self._lock:
            self._link, self._busy, self._sent_ns = link, 0, 0
            self._state = Link.UP if self._state is Link.DOWN else self._state
            self._counts["opens"] += 1
        self._retry_later(now_ns)
        threading.Thread(target=self._read, args=(link,), name="hand reader", daemon=True).start()

    def _retry_later(self, now_ns: int) -> None:
        """Should it be lost again, wait for longer, until a board has been heard."""
        self._reopen_ns = now_ns + self._pause_ns
        self._pause_ns = min(2 * self._pause_ns, _ns(self._config.max_reopen_s))

    def _lose(self, link: CanLink, state: Link, why: str) -> None:
        """Close a link that failed; whoever comes second, sender or reader, finds it done."""
        with self._lock:
            if self._link is not link:
                return
            self._link, self._state, self.last_error, self._lost = None, state, why, True
            self._reopen_ns = max(self._reopen_ns, self._clock.now_ns() + _ns(self._config.reopen_s))
            self._counts[state.value] += 1
            self._points.release()  # when the bus is back, a person decides whether the hand moves
        link.close()

    # --- receiving --------------------------------------------------------------------------------

    def _read(self, link: CanLink) -> None:
        while self._link is link:
            try:
                frame = link.receive(READ_TIMEOUT_S)
            except BadFrame as error:
                self._note_bad(error)
                continue
            except BusOff:
                self._lose(link, Link.BUS_OFF, "bus off")
                return
            except LinkError as error:
                self._lose(link, Link.DOWN, str(error))
                return
            if frame is not None:
                reply = host.decode(frame, self._hand.feedback_bytes)
                with self._lock:
                    self._take(self._clock.now_ns(), reply)

    def _note_bad(self, error: BadFrame) -> None:
        self.last_error = str(error)
        with self._lock:
            self._counts["bad_frames"] += 1

    def _take(self, now_ns: int, reply: Reply | Refusal) -> None:
        if isinstance(reply, Refusal):
            # Some buses let the sender hear its own frames, and another program may be listening in.
            own = reply.reason is Reason.OTHER_DIRECTION
            self._counts["commands_heard" if own else "refused_frames"] += 1
            return
        board = self._boards.take(now_ns, reply)
        if board is None:
            return
        self._state = Link.UP
        self._pause_ns = _ns(self._config.reopen_s)
        if board not in self._waiting:
            self._counts["repeated_answers"] += 1
            return
        self._waiting.discard(board)
        if not self._waiting:
            self._answered.set()
            self._round_trips_ms.append((now_ns - self._sent_ns) / 1e6)

    # --- telling ----------------------------------------------------------------------------------

    def _frame(self) -> HandFrame:
        with self._lock:
            counts = self._counts + self._boards.counts
            limits = {f"limit_{reason.value}": n for reason, n in self._points.counts.items()}
            numbers = {name: float(n) for name, n in (counts | limits).items()} | self._statistics
            error = self.last_error if self._state is Link.DOWN else ""
            now_ns = self._clock.now_ns()
            return hand_frame(now_ns, self._state, self._boards, self._points, numbers, error=error)


def _ns(seconds: float) -> int:
    return round(seconds * NS_PER_S)
