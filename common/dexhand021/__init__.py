"""The DexHand 021 on its CAN-FD bus: tables, values, and a codec for either side of the wire; all pure.

`host` is the computer's side, `device` the hand's (for the emulator). They share the tables and the value
types and no line of encoding, because a shared codec would hide symmetric mistakes.
"""
