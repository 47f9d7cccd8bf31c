"""What is wrong with a channel is said before or when it is opened, in words that help."""

import errno
import logging

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.can_config import CanConfig
from common.can_link import BadFrame, BusOff, Busy, CanLink, LinkError, arguments
from common.config import ConfigError, parse
from common.dexhand021.frames import Frame

SOCKETCAN = CanConfig(interface="socketcan", channel="can0")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"interface": "socketcan"}, "channel of socketcan must be a name, such as can0"),
        ({"interface": "pcan"}, "channel of pcan must be a name, such as PCAN_USBBUS1"),
        ({"interface": "kvaser", "channel": "can0"}, "channel of kvaser must be a number, such as 0"),
        ({"channel": "can0"}, "channel of udp_multicast must be a multicast group, not can0"),
        ({"channel": "192.168.0.1"}, "must be a multicast group, not 192.168.0.1"),
        ({"channel": True}, "input should be a valid string"),
        ({"interface": "slcan", "channel": "/dev/ttyUSB0"}, "input should be 'socketcan', 'pcan'"),
    ],
)
def test_a_channel_that_cannot_be_is_refused_with_an_example(values, said):
    with pytest.raises(ConfigError, match="test: can") as refused:
        parse(CanConfig, values, "test: can")
    assert said in str(refused.value)


@pytest.mark.parametrize(("given_as", "interface"), [(0, "kvaser"), ("1", "zlgcan"), (2, "vector")])
def test_a_numbered_channel_may_be_written_as_a_number(given_as, interface):
    config = CanConfig(interface=interface, channel=given_as)
    assert config.channel == str(given_as)
    assert arguments(config)["channel"] == int(given_as)


@given(st.ip_addresses(v=4))
def test_a_group_is_what_the_standard_says(address):
    if 224 <= int(address) >> 24 <= 239:
        assert CanConfig(channel=str(address)).channel == str(address)
    else:
        with pytest.raises(ValueError, match="multicast group"):
            CanConfig(channel=str(address))


def opening(monkeypatch, config, error):
    """What people are told when python-can raises this."""

    def broken(**_arguments):
        raise error

    monkeypatch.setattr(can, "Bus", broken)
    with pytest.raises(LinkError) as told:
        CanLink(config)
    return str(told.value)


@pytest.mark.parametrize(
    ("interface", "channel", "error", "said"),
    [
        ("socketcan", "can0", OSError(errno.EAFNOSUPPORT, "Address family"), "this kernel has no SocketCAN"),
        ("socketcan", "can7", OSError(errno.ENODEV, "No such device"), "`ip link` lists those"),
        ("pcan", "PCAN_USBBUS1", OSError("pcanbasic library not found."), "PEAK's PCANBasic library is not"),
        ("kvaser", "0", NameError("name 'canOpen' is not defined"), "Kvaser's library canlib is not"),
        ("zlgcan", "0", can.CanInterfaceNotImplementedError("Unknown"), "pip install zlgcan"),
        ("zlgcan", "0", ValueError("Could not open library: library/l"), "are not in can.library, library/:"),
        ("vector", "0", can.CanInterfaceNotImplementedError("Windows"), "not made for this system"),
        ("pcan", "PCAN_USBBUS1", can.CanInitializationError("no hardware"), "no hardware; is it plugged in"),
    ],
)
def test_a_channel_that_does_not_open_is_named_with_what_to_do(monkeypatch, interface, channel, error, said):
    told = opening(monkeypatch, CanConfig(interface=interface, channel=channel), error)
    assert told.startswith(f"{interface} {channel}: ") and said in told and "\n" not in told


def test_bit_rates_that_no_controller_has_are_named_beside_the_hands():
    with pytest.raises(LinkError, match="no timing gives 777 and 5000000 bit/s; the hand has 1000000"):
        CanLink(CanConfig(interface="pcan", channel="PCAN_USBBUS1", bit_rate=777))


def test_python_can_says_nothing_beside_our_errors(capfd):
    logging.getLogger("can.pcan").warning("uptime library not available")
    assert capfd.readouterr().err == ""


class Bus:
    """Raises what it is told to, or has said this."""

    state = can.BusState.ACTIVE

    def __init__(self, error=None, said=()):
        self.error, self.sent, self.said = error, [], list(said)

    def send(self, message, timeout=None):
        if self.error is not None:
            raise self.error
        self.sent.append(message)

    def recv(self, timeout):
        if self.error is not None:
            raise self.error
        return self.said.pop(0) if self.said else None


def test_the_zlg_plugin_is_told_of_all_channels_up_to_ours_and_heeds_that_of_messages(monkeypatch):
    said = [can.Message(arbitration_id=0x189, is_extended_id=False, channel=n) for n in (0, 1)]
    bus, wanted = Bus(said=said), {}
    monkeypatch.setattr(can, "Bus", lambda **arguments: wanted.update(arguments) or bus)
    link = CanLink(CanConfig(interface="zlgcan", channel=1, device_type=43, library="zlg"))
    each = {"bitrate": 1_000_000, "dbitrate": 5_000_000, "resistance": 1}
    assert wanted == {
        "interface": "zlgcan",
        "channel": 1,
        "device_type": 43,
        "device_index": 0,
        "libpath": "zlg",
        "configs": [each, each],
    }
    link.send(Frame(0x107, bytes(8)))
    assert [message.channel for message in bus.sent] == [1]
    assert [link.receive(0.0), link.receive(0.0)] == [None, Frame(0x189, b"")]


def test_whatever_a_makers_back_end_raises_ends_no_thread(monkeypatch):
    monkeypatch.setattr(can, "Bus", lambda **_arguments: Bus(ValueError("RUST-CAN - device was removed")))
    link = CanLink(CanConfig(interface="zlgcan", channel=0))
    with pytest.raises(Busy, match="device was removed"):
        link.send(Frame(0x107, bytes(8)))
    with pytest.raises(BadFrame, match="device was removed"):
        link.receive(0.0)


@pytest.mark.parametrize(
    ("error", "raised", "said"),
    [
        (can.CanOperationError("down", errno.ENETDOWN), LinkError, "the interface is down"),
        (can.CanOperationError("full", errno.ENOBUFS), Busy, ""),
        (can.CanTimeoutError("slow"), Busy, ""),
    ],
)
def test_a_frame_that_is_not_sent_says_why(monkeypatch, error, raised, said):
    cause = error.error_code and OSError(error.error_code, "as the system says")
    error.__cause__ = cause
    monkeypatch.setattr(can, "Bus", lambda **_arguments: Bus(error))
    link = CanLink(SOCKETCAN)
    with pytest.raises(raised) as told:
        link.send(Frame(0x100, bytes(8)))
    assert said in str(told.value)
    with pytest.raises(raised):
        link.send_bus_off()
    link._bus.state = can.BusState.ERROR
    with pytest.raises(BusOff):
        link.send(Frame(0x100, bytes(8)))
