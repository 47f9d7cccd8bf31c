"""A hundred thousand frames that nobody should have sent: hand and hand_io count them and obey none."""

import os
import random
import select
import socket
import time
from collections import Counter
from pathlib import Path

import can
import pytest
from can.interfaces.udp_multicast.utils import pack_message

from common.dexhand021 import device, host
from common.dexhand021.commands import (
    BoardMotion,
    BroadcastMotion,
    ClearError,
    FeedbackSetting,
    NvmRead,
    ShortMotion,
)
from common.dexhand021.frames import FD_LENGTHS, Frame, Reason, Refusal
from common.dexhand021.replies import (
    BoardFeedback,
    ConfigReply,
    ErrorReport,
    NvmReply,
    OverTemperature,
    Startup,
    WarningReport,
)
from common.dexhand021.tables import Hand, hand_and_board
from tests.faults.cell import wait
from tests.faults.hand_cell import HandCell

pytestmark = [pytest.mark.processes, pytest.mark.timeout(300)]

TOTAL, DISTINCT = 100_000, 20_000
AT_ONCE = 64  # datagrams; a socket holds about 160
SINKING_RAD_S = 0.06
REPLIES = (0x080, 0x180, 0x400, 0x600)  # + 7 to 12: what the right hand's boards say
COUNTED = {
    BoardFeedback: None,  # its contents are told
    ErrorReport: "error_frames",
    OverTemperature: "overheats",
    WarningReport: "warnings",
    Startup: "starts",
    ConfigReply: "answers",
    NvmReply: "answers",
}
KINDS = {"refused_frames", "other_hand", "bad_frames", *COUNTED.values()} - {None}


class Stranger:
    """Somebody else on the bus, who never sends faster than everybody there reads."""

    def __init__(self, config):
        self._to = config.channel, config.port
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(10.0)
        self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        self._socket.bind(("", config.port))
        group = socket.inet_aton(config.channel) + socket.inet_aton("0.0.0.0")
        self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)

    def send(self, datagrams):
        """Send them; returns when everybody has read them."""
        for i in range(0, len(datagrams), AT_ONCE):
            self._drain()
            under_way = Counter(datagrams[i : i + AT_ONCE])
            for datagram in datagrams[i : i + AT_ONCE]:
                self._socket.sendto(datagram, self._to)
            while under_way:  # what has come back here has reached the others
                under_way -= Counter([self._socket.recv(65536)])
            while self.waiting():
                time.sleep(0.0005)

    def _drain(self):
        while select.select([self._socket], [], [], 0)[0]:
            self._socket.recv(65536)

    def readers(self):
        """What /proc tells of each other socket on the bus's port."""
        rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
        own = str(os.fstat(self._socket.fileno()).st_ino)
        return [row for row in rows if row[1].endswith(f":{self._to[1]:04X}") and row[9] != own]

    def waiting(self):
        """Bytes that one of them has not read yet."""
        return sum(int(row[4].split(":")[1], 16) for row in self.readers())

    def dropped(self):
        """Datagrams for which one of them had no room."""
        return sum(int(row[12]) for row in self.readers())

    def close(self):
        self._socket.close()


def message(frame, extended=False):
    whole = can.Message(arbitration_id=frame.can_id, data=frame.data, is_fd=True, is_extended_id=extended)
    return pack_message(whole)


def fuzzed(count, seed=7):
    """(datagram, what it counts as or None) `count` times; none of them is a command to move."""
    draw = random.Random(seed)
    while count:
        data = draw.randbytes(draw.choice(FD_LENGTHS))
        said = draw.choice(REPLIES) + draw.randrange(7, 13)
        frame = Frame(draw.choice((draw.randrange(0x800), said)), spoilt(draw, data))
        if not isinstance(device.decode(frame), BoardMotion | ShortMotion | BroadcastMotion):
            count -= 1
            yield datagram_of(draw, frame)


def spoilt(draw, data):
    """Half of it as it is, the rest with the beginnings that replies have."""
    heads = (b"", b"", b"\xff" * 6, bytes((0xEE, draw.randrange(5))), b"\xef", b"\x03\xa4\0\1", b"\x01\x02")
    head = draw.choice(heads)
    return (head + data)[:64] if len(head) + len(data) in FD_LENGTHS else data


def datagram_of(draw, frame):
    other = draw.randrange(20)
    if other == 0:
        return draw.randbytes(draw.randrange(200)), "bad_frames"
    if other == 1:
        whole = message(frame)
        return whole[: draw.randrange(len(whole))], "bad_frames"
    if other == 2:
        return message(frame, extended=True), "bad_frames"
    return message(frame), kind_of(frame)


def kind_of(frame):
    reply = host.decode(frame, 56)
    if isinstance(reply, Refusal):
        return answered(frame) if reply.reason is Reason.OTHER_DIRECTION else "refused_frames"
    return COUNTED[type(reply)] if hand_and_board(reply.board)[0] is Hand.RIGHT else "other_hand"


def answered(frame):
    """The hand's answer to a stranger, which hand_io hears too."""
    command = device.decode(frame)
    understood = isinstance(command, ClearError | FeedbackSetting | NvmRead)
    return "answers" if understood and hand_and_board(command.board)[0] is Hand.RIGHT else None


@pytest.fixture(scope="module")
def hand(tmp_path_factory):
    cell = HandCell(tmp_path_factory.mktemp("fuzz"))
    try:
        cell.ready()
        yield cell
    finally:
        cell.end()


@pytest.fixture
def stranger(hand):
    one = Stranger(hand.cell.can)
    assert len(one.readers()) == 2
    yield one
    assert {process.poll() for process in hand.processes.values()} == {None}  # nobody has ended
    one.close()


def sinks_only(hand, rows):
    """Whether the joints do what they do without torque: give way to their weight, ever more slowly."""
    seconds = rows[-1, 0] - rows[0, 0]
    return not rows[:, -12:].any() and hand.physics.moved_rad(rows) < SINKING_RAD_S * seconds


def flood(hand, stranger, datagrams):
    """Send them all, again if the machine was too busy to deliver each; what hand_io counted meanwhile."""
    for _ in range(3):
        before, dropped = hand.counts(), stranger.dropped()
        stranger.send(datagrams)
        wait(lambda: not hand.joints.flags.any(), "the clearing of errors that there are not")
        wait(lambda: not hand.joints.faults and hand.state == "hold", "the end of false alarms")
        after = hand.counts()
        if stranger.dropped() == dropped:
            return {kind: after.get(kind, 0.0) - before.get(kind, 0.0) for kind in (*KINDS, "clears")}
    pytest.fail("this machine is too busy to deliver datagrams")


def test_all_are_counted_and_nothing_moves(hand, stranger):
    frames = list(fuzzed(DISTINCT)) * (TOTAL // DISTINCT)
    expected = Counter(kind for _, kind in frames)
    assert min(expected[kind] for kind in KINDS) > 100
    wait(lambda: hand.physics.rows()[-1, 0] - hand.physics.rows()[0, 0] > 4.0, "the limp hand to lie down")
    at = time.monotonic()
    counted = flood(hand, stranger, [datagram for datagram, _ in frames])
    expected["answers"] += counted.pop("clears")  # the hand answers those as well
    assert counted == {kind: expected[kind] for kind in KINDS}
    assert sinks_only(hand, hand.physics.since(at))
    assert not hand.steps


def test_they_lead_no_joint_of_a_hand_at_work_out_of_its_range_and_it_can_go_on(hand, stranger):
    hand.run()
    at = time.monotonic()
    stranger.send([datagram for datagram, _ in fuzzed(5000, seed=8)])
    assert hand.physics.beyond_rad(hand.physics.since(at)) < 0.01
    wait(lambda: not hand.joints.faults, "the end of false alarms")
    hand.run()
    wait(lambda: bool(hand.physics.powered.all()), "torque")
