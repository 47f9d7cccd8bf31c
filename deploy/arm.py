"""`python -m deploy.arm [--off|--status] [CELL] [--set a.b=c]`: let a real hand move, or stop it.

Stand where you see the hand and reach its power switch. Exit codes: 0 done, 1 refused, 2 wrong cell.
"""

from __future__ import annotations

import argparse
import sys

from common.built import new_boot_id
from common.codec import Codec, Refused
from common.config import ConfigError
from common.desk import ANSWER_S
from common.hand_messages import ArmReply, ArmRequest, ArmWish
from common.messages import Header
from common.topics import ARM_REPLY
from common.zenoh_bus import ZenohBus
from common.zenoh_router import BusError
from deploy.cell import Cell, load_cell
from services.hand_io.desk import QUERY

ROUTER_TIMEOUT_S = 3.0


def main(argv: list[str] | None = None) -> int:
    """Ask hand_io and print what it says."""
    options = _parser().parse_args(argv)
    try:
        cell = load_cell(options.cell, options.overrides)
        if cell.plant == "sim":
            raise ConfigError([f"cell {cell.cell} has no hand to arm: it is all in simulation"])
        reply = ask(cell, options.wish)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except (BusError, TimeoutError) as error:
        print(error, file=sys.stderr)
        return 1
    print(f"hand_io: {reply.state or 'unknown'}{f': {reply.reason}' if reply.reason else ''}")
    return int(not reply.accepted)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m deploy.arm", description=__doc__)
    parser.add_argument("cell", nargs="?", default="dexhand_twin", help="a file, or a name in deploy/cells")
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="a.b=c")
    wish = parser.add_mutually_exclusive_group()
    off, status = "the hand holds for hold_s, then is limp; given twice, it is limp at once", "only ask"
    wish.add_argument("--off", dest="wish", action="store_const", const=ArmWish.DISARM, help=off)
    wish.add_argument("--status", dest="wish", action="store_const", const=ArmWish.STATUS, help=status)
    parser.set_defaults(wish=ArmWish.ARM)
    return parser


def ask(cell: Cell, wish: ArmWish) -> ArmReply:
    """Pass a wish to hand_io. Raises BusError without a router, TimeoutError without an answer."""
    patient = cell.bus.model_copy(update={"connect_timeout_s": ROUTER_TIMEOUT_S})
    bus, codec = ZenohBus(patient, cell.cell, "arm"), Codec()
    try:
        request = codec.encode(Header(new_boot_id(), 0, 0, True), ArmRequest(wish))
        payload = bus.ask(QUERY, request, ANSWER_S + 1.0)
        if payload is None:
            raise TimeoutError("hand_io does not answer: is it running? `deploy/run_all.sh status`")
        return codec.decode(ARM_REPLY.key, payload).message
    except Refused as error:
        raise TimeoutError(f"hand_io answers in another language: {error}") from None
    finally:
        bus.close()


if __name__ == "__main__":
    sys.exit(main())
