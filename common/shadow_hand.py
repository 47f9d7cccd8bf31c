"""The Shadow Hand of the simulated tasks as data: links, finger capsules, palm, and how its joints follow.

Dimensions from Gymnasium-Robotics 1.4.2, assets/hand (MIT); a test compares them with the compiled model.
"""

from __future__ import annotations

from common.hand_model import Capsule, HandModel, Link, Plane, Servo, Vector

_X, _Y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
_HERE = (0.0, 0.0, 0.0)
_UPRIGHT = (0.0, 0.0, -(0.5**0.5), 0.5**0.5)  # of the mount: palm up, fingers to -y


def _finger(name: str, parent: str, base: Vector) -> tuple[Link, ...]:
    proximal, middle, distal = f"{name}proximal", f"{name}middle", f"{name}distal"
    joint = name.upper() + "J"
    return (
        Link(f"{name}knuckle", parent, base, f"{joint}3", _Y),
        Link(proximal, f"{name}knuckle", _HERE, f"{joint}2", _X),
        Link(middle, proximal, (0.0, 0.0, 0.045), f"{joint}1", _X),
        Link(distal, middle, (0.0, 0.0, 0.025), f"{joint}0", _X),
    )


def _rods(name: str, lengths: Vector, radii: Vector) -> tuple[Capsule, ...]:
    links = (f"{name}proximal", f"{name}middle", f"{name}distal")
    parts = zip(links, lengths, radii, strict=True)
    return tuple(Capsule(link, _HERE, (0.0, 0.0, length), radius) for link, length, radius in parts)


def _servos(name: str) -> tuple[Servo, ...]:
    """A finger's joints; a slack tendon lets the last one coast."""
    joint = name.upper() + "J"
    return (
        Servo(f"{joint}3", 0.265, 0.009, -0.349, 0.349),
        Servo(f"{joint}2", 0.265, 0.009, 0.0, 1.571),
        Servo(f"{joint}1", 0.197, 0.002, 0.0, 1.571),
        Servo(f"{joint}0", 0.0, 0.034),
    )


_THUMB = (
    Link("thbase", "palm", (0.034, -0.009, 0.029), "THJ4", (0.0, 0.0, -1.0), (0.923956, 0.0, 0.382499, 0.0)),
    Link("thproximal", "thbase", _HERE, "THJ3", _X),
    Link("thhub", "thproximal", (0.0, 0.0, 0.038), "THJ2", _X),
    Link("thmiddle", "thhub", _HERE, "THJ1", _Y),
    Link("thdistal", "thmiddle", (0.0, 0.0, 0.032), "THJ0", _Y),
)
_LITTLE_AXIS = (0.570977, 0.0, 0.820966)
_FINGER_LENGTHS, _FINGER_RADII = (0.045, 0.025, 0.024), (0.010, 0.00805, 0.00705)

# pull and carry_s: least squares over 10 000 random steps beside an egg, touching ones trimmed.
SHADOW_HAND = HandModel(
    links=(
        Link("wrist", "", (1.0, 0.994, 0.14), "WRJ1", _Y, _UPRIGHT),
        Link("palm", "wrist", (0.0, 0.0, 0.034), "WRJ0", _X),
        *_finger("ff", "palm", (0.033, 0.0, 0.095)),
        *_finger("mf", "palm", (0.011, 0.0, 0.099)),
        *_finger("rf", "palm", (-0.011, 0.0, 0.095)),
        Link("lfmetacarpal", "palm", (-0.017, 0.0, 0.044), "LFJ4", _LITTLE_AXIS),
        *_finger("lf", "lfmetacarpal", (-0.017, 0.0, 0.044)),
        *_THUMB,
    ),
    capsules=(
        *(rod for name in ("ff", "mf", "rf", "lf") for rod in _rods(name, _FINGER_LENGTHS, _FINGER_RADII)),
        *_rods("th", (0.038, 0.032, 0.026), (0.013, 0.011, 0.00918)),
    ),
    palm=Plane("palm", (0.0, -0.0111, 0.038), (0.0, -1.0, 0.0)),
    servos=(
        Servo("WRJ1", 0.171, 0.020, -0.489, 0.140),
        Servo("WRJ0", 0.103, 0.021, -0.698, 0.489),
        *_servos("ff"),
        *_servos("mf"),
        *_servos("rf"),
        Servo("LFJ4", 0.173, 0.015, 0.0, 0.785),
        *_servos("lf"),
        Servo("THJ4", 0.268, 0.009, -1.047, 1.047),
        Servo("THJ3", 0.259, 0.010, 0.0, 1.222),
        Servo("THJ2", 0.266, 0.009, -0.209, 0.209),
        Servo("THJ1", 0.271, 0.008, -0.524, 0.524),
        Servo("THJ0", 0.274, 0.008, -1.571, 0.0),
    ),
)
