"""CAN-FD frames in and out through python-can, whatever the adapter; the only module that opens one."""

from __future__ import annotations

import errno
import logging
from typing import Any

import can
from can import BitTimingFd, BusState, CanProtocol

from common.can_config import BIT_RATE, DATA_BIT_RATE, CanConfig
from common.dexhand021.frames import Frame, padded

SEND_TIMEOUT_S = 0.005
RX_QUEUE = 4096  # of the virtual bus, which would otherwise grow without bound
BUSY = (errno.ENOBUFS, errno.EAGAIN)
_ERROR_BUS_OFF = 0x40  # class bit in the id of an error frame, linux/can/error.h
_MISSING = {
    "socketcan": "this kernel has no SocketCAN: `modprobe can_raw`; most containers have none",
    "pcan": "PEAK's PCANBasic library is not installed",
    "kvaser": "Kvaser's library canlib is not installed",
    "vector": "Vector's XL library is not installed, or not made for this system",
    "zlgcan": "the plugin is not installed: .venv/bin/pip install zlgcan",
}
_NO_LIBRARY = "ZLG's libraries are not in can.library, {}: see docs/guides/dexhand.md"
_WHY = {
    errno.EAFNOSUPPORT: _MISSING["socketcan"],
    errno.ENODEV: "there is no such interface: `ip link` lists those that there are",
    errno.ENETDOWN: "the interface is down: deploy.doctor can says how to bring it up",
}

# What python-can's back ends have to say is in our errors, for those that are in use.
logging.getLogger("can").addHandler(logging.NullHandler())


class LinkError(Exception):
    """The bus cannot be used any more, or cannot be opened; the message is one line."""


class Busy(Exception):  # noqa: N818 - a state, not a mistake
    """The frame was not sent, most likely for a full queue of the adapter's; the next one may be."""


class BadFrame(Exception):  # noqa: N818 - about what arrived
    """Something arrived that is no CAN frame; the bus is as usable as before."""


class BusOff(Exception):  # noqa: N818 - a state of the bus
    """The controller has left the bus after too many errors."""


def arguments(config: CanConfig) -> dict[str, Any]:
    """What python-can wants to know to open this channel for CAN FD at the hand's bit rates."""
    number = int(config.channel) if config.channel.isdigit() else config.channel
    rates = {"bitrate": config.bit_rate, "dbitrate": config.data_bit_rate}
    own: dict[str, dict[str, Any]] = {
        "socketcan": {"fd": True},  # the rates are the link's: ip link set can0 type can bitrate ... fd on
        "udp_multicast": {"port": config.port, "hop_limit": 0, "fd": True},
        "virtual": {"protocol": CanProtocol.CAN_FD, "rx_queue_size": RX_QUEUE},
        "pcan": {"timing": _timing(config)},
        "kvaser": {"channel": number, "timing": _timing(config)},
        "vector": {"channel": number, "timing": _timing(config), "fd": True, "app_name": None},
        "zlgcan": {
            "channel": number,
            "device_type": config.device_type,
            "device_index": config.device,
            "libpath": config.library,
            # The plugin counts channels by these and heeds `channel` of messages alone.
            "configs": [{**rates, "resistance": int(config.termination)}] * (_zlg_channel(config) + 1),
        },
    }
    return {"channel": config.channel, **own[config.interface]}


def _zlg_channel(config: CanConfig) -> int:
    return int(config.channel) if config.interface == "zlgcan" else 0


def _timing(config: CanConfig) -> BitTimingFd:
    """Sample points of 80 % and 75 %, as the maker's own software sets them."""
    try:
        return BitTimingFd.from_sample_point(
            f_clock=80_000_000,
            nom_bitrate=config.bit_rate,
            nom_sample_point=80.0,
            data_bitrate=config.data_bit_rate,
            data_sample_point=75.0,
        )
    except ValueError:
        wanted = f"{config.bit_rate} and {config.data_bit_rate} bit/s"
        raise LinkError(f"no timing gives {wanted}; the hand has {BIT_RATE} and {DATA_BIT_RATE}") from None


class CanLink:
    """One open channel. `receive` and `send` may be called from two threads."""

    def __init__(self, config: CanConfig, bit_rate_switch: bool = False) -> None:
        """Open it. Raises LinkError saying why not."""
        self._config = config
        self._bit_rate_switch = bit_rate_switch
        self._closed = False
        try:
            self._bus = can.Bus(interface=config.interface, **arguments(config))
        except Exception as error:  # makers' back ends raise anything, NameError for a missing library
            why = _known(config, error) or f"{_line(error)}; is it plugged in, and the channel right?"
            raise LinkError(f"{config.interface} {config.channel}: {why}") from None

    def send(self, frame: Frame) -> None:
        """Send one frame with an 11-bit id. Raises Busy, BusOff, LinkError."""
        full = padded(frame)
        message = can.Message(
            arbitration_id=full.can_id,
            data=full.data,
            is_extended_id=False,
            is_fd=True,
            bitrate_switch=self._bit_rate_switch,
            channel=_zlg_channel(self._config),
        )
        self._send(message)

    def send_bus_off(self) -> None:
        """Tell the others that the bus is off, as a controller tells its host: for the emulator alone.

        Raises Busy, BusOff, LinkError.
        """
        self._send(can.Message(arbitration_id=_ERROR_BUS_OFF, is_error_frame=True, dlc=8, data=bytes(8)))

    def _send(self, message: can.Message) -> None:
        try:
            if self._bus.state is BusState.ERROR:
                raise BusOff
            self._bus.send(message, timeout=SEND_TIMEOUT_S)
        except can.CanTimeoutError:
            raise Busy from None
        except BusOff:
            raise
        except Exception as error:
            # Without the system's number nobody knows: the driver gives up on a link that stays busy.
            if _number(error) in (None, *BUSY):
                raise Busy(_line(error)) from None
            raise LinkError(_known(self._config, error) or _line(error)) from None

    def receive(self, timeout_s: float) -> Frame | None:
        """Wait for a frame; None if none came. Raises BadFrame, BusOff, LinkError."""
        try:
            message = self._bus.recv(timeout_s)
        except Exception as error:
            if self._closed or _number(error) is not None:  # else it is what came that cannot be read
                raise LinkError(_known(self._config, error) or _line(error)) from None
            raise BadFrame(_line(error)) from None
        if message is None or self._of_another_channel(message):
            return None
        if message.is_error_frame:
            if message.arbitration_id & _ERROR_BUS_OFF:
                raise BusOff
            raise BadFrame("error frame")
        if message.is_extended_id or message.is_remote_frame:
            raise BadFrame("not a data frame with an 11-bit id")
        return Frame(message.arbitration_id, bytes(message.data))

    def _of_another_channel(self, message: can.Message) -> bool:
        return self._config.interface == "zlgcan" and message.channel != _zlg_channel(self._config)

    def close(self) -> None:
        """Release the adapter; a `receive` under way ends with an exception or nothing."""
        self._closed = True
        self._bus.shutdown()


def _number(error: BaseException) -> int | None:
    """The system's error number behind an exception of python-can, if there is one."""
    causes = (each for each in (error, error.__cause__) if isinstance(each, OSError))
    return next((each.errno for each in causes if each.errno is not None), None)


def _known(config: CanConfig, error: BaseException) -> str:
    """What is wrong and what to do about it, where that is known; else nothing."""
    if isinstance(error, LinkError):
        return str(error)
    unknown = isinstance(error, can.CanInterfaceNotImplementedError | NameError | ImportError)
    if unknown or "library not found" in str(error):
        return _MISSING.get(config.interface, "")
    if config.interface == "zlgcan" and "open library" in str(error):
        return _NO_LIBRARY.format(config.library)
    return _WHY.get(_number(error) or 0, "") if config.interface == "socketcan" else ""


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
