"""`python -m deploy.doctor can [CELL] [--status] [--set a.b=c]`: is the hand there?

It listens and reads memory, which changes nothing. Only with --status, and only on a quiet bus, does it also
send one motion command that gives no motor torque: that makes boards tell temperatures and errors, and a hand
that still holds something lets go of it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import time
from collections.abc import Iterator
from statistics import median
from typing import Any

from common.can_config import BIT_RATE, DATA_BIT_RATE
from common.can_link import BadFrame, BusOff, Busy, CanLink, LinkError
from common.config import ConfigError
from common.dexhand021 import host
from common.dexhand021.commands import BroadcastMotion, Command, MotorTarget, NvmRead
from common.dexhand021.frames import Refusal
from common.dexhand021.replies import (
    BoardFeedback,
    ErrorReport,
    MotorFlag,
    NvmReply,
    OverTemperature,
    Reply,
)
from common.dexhand021.tables import BOARDS, MOTORS, ControlMode, Hand, NvmAddress, board_id, hand_and_board
from deploy.cell import Cell, load_cell
from deploy.checks import Check, print_checks, read_options

LISTEN_S, ANSWER_S, PINGS = 0.5, 0.1, 5
ROUND_TRIP_LIMIT_MS = 10.0
WHERE = {
    True: "is the emulated hand running, with the same can.channel and can.port?",
    False: "power, cable, and left or right hand in the cell?",
}
HANDS = "name a cell with plant: twin or hand, such as dexhand_twin"
QUIET = "the bus is quiet, temperatures and errors unknown: --status asks, and takes all torque away"
LINK_ADVICE = "ip link set {0} up type can bitrate {1} dbitrate {2} fd on restart-ms 100"


def main(argv: list[str] | None = None) -> int:
    """Print one line per check; 1 if any failed."""
    parser = argparse.ArgumentParser(prog="python -m deploy.doctor can", description=__doc__)
    parser.add_argument(
        "--status", action="store_true", help="on a quiet bus have the boards report: ALL TORQUE GOES AWAY"
    )
    options = read_options(parser, "dexhand_twin", argv)
    return print_checks(checks(options.cell, options.overrides, status=options.status))


def checks(cell_name: str, overrides: list[str], *, status: bool = False) -> Iterator[Check]:
    """Examine adapter, bit rates, boards; stops where nothing more can be seen.

    `status`: whether a hand that nobody drives may be sent what takes its torque away.
    """
    try:
        cell = load_cell(cell_name, overrides)
    except ConfigError as error:
        yield from (Check(False, "config", line, "correct the cell") for line in error.lines)
        return
    if cell.plant == "sim":
        yield Check(False, "config", f"cell {cell.cell} has no bus: its hand is all in simulation", HANDS)
        return
    try:
        link = CanLink(cell.can, cell.hand.bit_rate_switch)
    except LinkError as error:
        yield Check(False, "adapter", str(error))
        return
    try:
        yield Check(True, "adapter", f"{cell.can.interface} {cell.can.channel} opened for CAN FD")
        yield _bit_rates(cell)
        yield from _hand(cell, link, status)
    finally:
        link.close()


def _bit_rates(cell: Cell) -> Check:
    can = cell.can
    wanted = f"{can.bit_rate} and {can.data_bit_rate} bit/s"
    if can.simulated:
        return Check(True, "bit rates", "a simulated bus has none")
    if can.interface != "socketcan":
        right = (can.bit_rate, can.data_bit_rate) == (BIT_RATE, DATA_BIT_RATE)
        advice = f"the maker's are {BIT_RATE} and {DATA_BIT_RATE}: leave both options out"
        return Check(right, "bit rates", f"set to {wanted} by this program", advice)
    found = _link_rates(can.channel)
    advice = LINK_ADVICE.format(can.channel, can.bit_rate, can.data_bit_rate)
    right = found == (can.bit_rate, can.data_bit_rate)
    return Check(right, "bit rates", f"{found[0]} and {found[1]} bit/s" if found else "unknown", advice)


def _link_rates(channel: str) -> tuple[int, int] | None:
    """What the kernel says of a SocketCAN link, or None."""
    try:
        done = subprocess.run(
            ("ip", "-json", "-details", "link", "show", channel), capture_output=True, timeout=5, check=True
        )
        data: dict[str, Any] = json.loads(done.stdout)[0]["linkinfo"]["info_data"]
        return int(data["bittiming"]["bitrate"]), int(data["data_bittiming"]["bitrate"])
    except (OSError, subprocess.SubprocessError, ValueError, KeyError, IndexError):
        return None


def _hand(cell: Cell, link: CanLink, status: bool) -> Iterator[Check]:
    examiner = Examiner(cell, link)
    try:
        examiner.listen(LISTEN_S)
        driven = bool(examiner.statuses)
        quiet = "the bus is quiet" if status else QUIET
        yield Check(True, "traffic", "hand_io is driving the hand" if driven else quiet)
        if status and not driven:
            examiner.ask_status()
        if examiner.others:
            other = "left" if cell.hand.hand is Hand.RIGHT else "right"
            found = f"boards of a {other} hand are heard, the cell's is the {cell.hand.hand.value} one"
            yield Check(False, "hand", found, f"hand.hand: {other}, unless there are two")
        for board in range(len(BOARDS)):
            yield examiner.board(board)
    except BusOff:
        yield Check(False, "bus", "bus off", "check termination, wiring and bit rates; is the hand powered?")
    except Busy as error:
        found = f"nothing can be sent: {error}" if str(error) else "nothing can be sent"
        yield Check(False, "bus", found, "is the hand powered and connected?")
    except LinkError as error:
        advice = LINK_ADVICE.format(cell.can.channel, cell.can.bit_rate, cell.can.data_bit_rate)
        advice = advice if cell.can.interface == "socketcan" else "is the adapter still there?"
        yield Check(False, "bus", str(error), advice)


class Examiner:
    """Asks boards one by one and notes what else is heard; all methods may raise BusOff, Busy, LinkError."""

    def __init__(self, cell: Cell, link: CanLink) -> None:
        self._hand, self._link = cell.hand, link
        self._pause_c = cell.hand_io.limits.pause_c
        self._absent = WHERE[cell.can.simulated]
        self.others = 0  # status frames of the other hand
        self.statuses: dict[int, BoardFeedback] = {}
        self._latched: dict[int, tuple[MotorFlag, MotorFlag]] = {}  # as told by error frames
        self._hot: set[int] = set()

    def listen(self, seconds: float, board: int = 0, address: NvmAddress | None = None) -> NvmReply | None:
        """Hear replies until the wanted one, or for so long."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            reply = self._receive(left)
            if isinstance(reply, NvmReply) and (reply.board, reply.address) == (board, address):
                return reply
        return None

    def _receive(self, seconds: float) -> Reply | None:
        try:
            frame = self._link.receive(seconds)
        except BadFrame:
            return None
        reply = host.decode(frame, self._hand.feedback_bytes) if frame else None
        if isinstance(reply, BoardFeedback):
            self.others += hand_and_board(reply.board)[0] is not self._hand.hand
            self.statuses[reply.board] = reply
        elif isinstance(reply, ErrorReport):
            self._latched[reply.board] = _united(self._latched.get(reply.board), reply.flags)
        elif isinstance(reply, OverTemperature):
            self._hot.add(reply.board)
        return None if isinstance(reply, Refusal) else reply

    def ask_status(self) -> None:
        """Have all boards report, without torque."""
        nothing = MotorTarget(enabled=False, position=0, speed=0, current=0)
        self._send(BroadcastMotion(self._hand.hand, ControlMode.ZERO_TORQUE, (nothing,) * MOTORS))
        self.listen(ANSWER_S)

    def _send(self, command: Command) -> None:
        self._link.send(host.encode(command))

    def _read(self, board: int, address: NvmAddress) -> tuple[int, float] | None:
        """A value of a board's memory and how long it took, in ms; None without an answer."""
        begin = time.monotonic()
        self._send(NvmRead(board, address))
        reply = self.listen(ANSWER_S, board, address)
        return None if reply is None else (reply.value, (time.monotonic() - begin) * 1e3)

    def board(self, index: int) -> Check:
        """One line about board 0-5."""
        identity = board_id(self._hand.hand, index)
        about = f"{BOARDS[index].name} (id {identity})"
        answers = [self._read(identity, NvmAddress.FIRMWARE) for _ in range(PINGS)]
        heard = [answer for answer in answers if answer is not None]
        if not heard:
            return Check(False, about, "does not answer", self._absent)
        round_trip_ms = median(answer[1] for answer in heard)
        safe = self._read(identity, NvmAddress.SAFE_TEMPERATURE_C)
        found = [
            f"firmware {heard[0][0]}",
            f"round trip {round_trip_ms:.2f} ms",
            *self._temperature(identity),
        ]
        found += [f"powers off at {safe[0]} °C"] if safe else []
        lost = PINGS - len(heard)
        wrong = [f"{lost} of {PINGS} answers lost"] if lost else []
        wrong += ["slow"] if round_trip_ms > ROUND_TRIP_LIMIT_MS else []
        wrong += self._ailments(identity)
        return Check(
            not wrong, about, ", ".join(found + wrong), "let it cool, free the finger, check the wiring"
        )

    def _temperature(self, identity: int) -> list[str]:
        status = self.statuses.get(identity)
        return [f"{status.temperature_c} °C"] if status and status.temperature_c is not None else []

    def _ailments(self, identity: int) -> list[str]:
        if identity in self._hot:
            return ["over-temperature"]
        status = self.statuses.get(identity)
        hot = status is not None and (status.temperature_c or 0) >= self._pause_c
        # Short statuses carry no errors, and padding reads as none: an error frame counts all the same.
        flags = _united(self._latched.get(identity), status.errors if status else None)
        names = [flag.name or str(int(flag)) for flag in flags if flag]
        names = names or ["an error without a code"] * (identity in self._latched)
        return (["too hot to run"] if hot else []) + ([f"latched {' '.join(names)}"] if names else [])


def _united(
    one: tuple[MotorFlag, MotorFlag] | None, other: tuple[MotorFlag, MotorFlag] | None
) -> tuple[MotorFlag, MotorFlag]:
    none = (MotorFlag(0), MotorFlag(0))
    first, second = one or none, other or none
    return first[0] | second[0], first[1] | second[1]
