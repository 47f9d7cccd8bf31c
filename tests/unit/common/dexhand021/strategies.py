"""Any command, any reply, any frame."""

from __future__ import annotations

from hypothesis import strategies as st

from common.dexhand021.commands import (
    BoardMotion,
    BroadcastMotion,
    ClearError,
    Command,
    FeedbackSetting,
    MotorTarget,
    NvmRead,
    ShortMotion,
    ShortTarget,
)
from common.dexhand021.frames import Frame
from common.dexhand021.replies import BoardFeedback, ConfigReply, MotorFlag, MotorState, NvmReply, Tactile
from common.dexhand021.tables import NVM_BYTES, ControlMode, FeedbackMode, Hand, NvmAddress

BOARD_IDS = st.integers(1, 12)
I16 = st.integers(-(2**15), 2**15 - 1)
U8, U16, U32 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32))
MODES = st.sampled_from(ControlMode)
TARGETS = st.builds(MotorTarget, st.booleans(), I16, st.integers(0, 32767), U8)
SHORT_TARGETS = st.builds(ShortTarget, st.booleans(), I16)

COMMANDS: st.SearchStrategy[Command] = st.one_of(
    st.builds(BoardMotion, BOARD_IDS, MODES, st.tuples(TARGETS, TARGETS)),
    st.builds(ShortMotion, BOARD_IDS, MODES, st.tuples(SHORT_TARGETS, SHORT_TARGETS)),
    st.builds(
        BroadcastMotion,
        st.sampled_from(Hand),
        MODES,
        st.tuples(*[TARGETS] * 12),
        st.booleans(),
        st.booleans(),
    ),
    st.builds(ClearError, BOARD_IDS),
    st.builds(
        FeedbackSetting,
        BOARD_IDS,
        st.sampled_from(FeedbackMode),
        st.integers(0, 255).map(lambda units: 10 * units),
        st.booleans(),
    ),
    st.builds(NvmRead, BOARD_IDS, st.sampled_from(NvmAddress)),
)

F32 = st.one_of(st.none(), st.floats(width=32, allow_nan=False, allow_infinity=False))
TACTILES = st.builds(Tactile, F32, U32, F32, U32, st.one_of(st.none(), st.integers(0, 359)), U32)
STATES = st.builds(MotorState, I16, I16, I16, I16)
FLAGS = U8.map(MotorFlag)
FINGERS = st.sampled_from([1, 3, 4, 5, 6, 7, 9, 10, 11, 12])
FEEDBACKS = st.builds(
    BoardFeedback,
    FINGERS,
    st.tuples(STATES, STATES),
    TACTILES,
    U32,
    st.tuples(U16, U16),
    st.tuples(FLAGS, FLAGS),
    st.tuples(F32, F32),
)


@st.composite
def nvm_replies(draw: st.DrawFn) -> NvmReply:
    address = draw(st.sampled_from(NvmAddress))
    return NvmReply(draw(BOARD_IDS), address, draw(st.integers(0, 256 ** NVM_BYTES[address] - 1)))


REPLIES = st.one_of(FEEDBACKS, st.builds(ConfigReply, BOARD_IDS, U8, st.booleans()), nvm_replies())

# Mostly ids that mean something, so that the bytes behind them are reached.
IDS = st.one_of(
    st.integers(-5, 2**29),
    st.integers(0, 0x7FF),
    st.builds(
        lambda base, board: base + board, st.sampled_from([0, 0x80, 0x100, 0x180, 0x400, 0x600]), BOARD_IDS
    ),
)
FIRST = st.sampled_from([0, 1, 2, 3, 0x44, 0xEE, 0xEF, 0xFF])
DATA = st.one_of(
    st.binary(max_size=80),
    st.builds(lambda first, rest: bytes([first]) + rest, FIRST, st.binary(max_size=7)),
    st.binary(min_size=64, max_size=64),
)
FRAMES = st.builds(Frame, IDS, DATA)
