"""Where a hand's CAN-FD bus is, as options; this module needs no CAN library."""

from __future__ import annotations

from ipaddress import ip_address
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from common.config import Frozen

Interface = Literal["socketcan", "pcan", "kvaser", "vector", "zlgcan", "udp_multicast", "virtual"]
# Nothing that is reached through these can hurt anybody.
SIMULATED: tuple[Interface, ...] = ("udp_multicast", "virtual")
BIT_RATE, DATA_BIT_RATE = 1_000_000, 5_000_000  # the only pair in the maker's software
_EXAMPLES: dict[Interface, str] = {"socketcan": "can0", "pcan": "PCAN_USBBUS1"}
_NUMBERED: tuple[Interface, ...] = ("kvaser", "vector", "zlgcan")


class CanConfig(Frozen):
    """One channel of one adapter; bit rates are those of the hand's maker, the only pair in use."""

    interface: Interface = Field(default="udp_multicast", description="python-can's name of the adapter")
    channel: str = Field(
        default="239.74.163.2",
        min_length=1,
        description="can0, PCAN_USBBUS1, 0, ...; a multicast group for udp_multicast",
    )
    port: int = Field(
        default=43113, ge=1024, le=65535, description="of udp_multicast; hands that share one hear each other"
    )
    bit_rate: int = Field(default=BIT_RATE, gt=0, description="of the arbitration phase, bit/s")
    data_bit_rate: int = Field(default=DATA_BIT_RATE, gt=0, description="of the data phase, bit/s")
    device: int = Field(default=0, ge=0, description="zlgcan alone: which adapter, where there are several")
    device_type: int = Field(
        default=41, ge=0, description="zlgcan alone: 41 is USBCANFD-200U, 42 100U, 43 the mini"
    )
    library: str = Field(
        default="library/", min_length=1, description="zlgcan alone: folder of ZLG's libraries"
    )
    termination: bool = Field(default=True, description="zlgcan alone: switch the adapter's resistor on")

    @field_validator("channel", mode="before")
    @classmethod
    def _number_as_text(cls, channel: Any) -> Any:
        return str(channel) if isinstance(channel, int) and not isinstance(channel, bool) else channel

    @model_validator(mode="after")
    def _fitting_channel(self) -> CanConfig:
        if self.interface in _NUMBERED and not self.channel.isdigit():
            raise ValueError(f"channel of {self.interface} must be a number, such as 0")
        if self.interface == "udp_multicast" and not _is_group(self.channel):
            raise ValueError(f"channel of udp_multicast must be a multicast group, not {self.channel}")
        if self.interface in _EXAMPLES and _is_group(self.channel):
            example = _EXAMPLES[self.interface]
            raise ValueError(
                f"channel of {self.interface} must be a name, such as {example}, not {self.channel}"
            )
        return self

    @property
    def simulated(self) -> bool:
        """Whether only an emulated hand can be on this bus."""
        return self.interface in SIMULATED


def _is_group(text: str) -> bool:
    try:
        return ip_address(text).is_multicast
    except ValueError:
        return False
