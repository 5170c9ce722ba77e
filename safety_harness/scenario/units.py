"""Convert quantities such as ``80 mm`` or ``0.5 m/s`` to SI, with a single rounding.

The SI value is the float that is nearest to the written quantity, so ``80 mm`` becomes the literal ``0.08``.
Degrees are the exception: ``math.radians`` converts them, because pi is not a fraction.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

from safety_harness.base.exceptions import Place, ScenarioError, near_miss

_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_LONGEST_NUMBER = 64  # characters; a float's shortest exact form has at most 24
_LARGEST_EXPONENT = 400  # decimal; no float is that large

OTHER_UNIT = "nothing in a cell comes near to that: probably another unit is meant"
_RARE = ("cm", "/cm", "mrad", "min", "km/h", "kHz")  # units that we read but do not write

_Factor = Fraction | None  # None: degrees, by math.radians


@dataclass(frozen=True, eq=False)
class Dimension:
    """A kind of quantity, with its units and the factors from these units to SI.

    Messages use the name and the example. The name of a settings field of this dimension ends in ``suffix``.
    The field's value lies from ``least`` to ``most``, in SI, unless the field has its own bounds. ``bare``
    allows a number without a unit. ``bare`` is True for plain numbers and for fractions. A fraction may also
    have the unit ``%``.
    """

    name: str
    example: str
    si: str
    units: Mapping[str, _Factor]
    suffix: str
    least: float
    most: float
    bare: bool = False

    @property
    def expected(self) -> str:
        """The words that complete the sentence "expected ..."."""
        article = "an" if self.name[0] in "aeiou" else "a"
        return f"{article} {self.name} such as {self.example}"

    @property
    def most_of_limits(self) -> float:
        """The largest sensible limit of a claim in SI.

        A limit on time may be as long as a run.
        """
        return max(self.most, {"time": 3600.0, "number": 100.0}.get(self.name, 0.0))


def _powers(scale: Mapping[str, _Factor], suffix: str = "") -> dict[str, _Factor]:
    """Return the units of ``scale`` with ``suffix`` appended to their names.

    The factors are unchanged.
    """
    return {unit + suffix: factor for unit, factor in scale.items()}


# The factors are exact, so that a product is rounded only once.
_METRES: dict[str, _Factor] = {"m": Fraction(1), "cm": Fraction(1, 100), "mm": Fraction(1, 1000)}
_RADIANS: dict[str, _Factor] = {"rad": Fraction(1), "mrad": Fraction(1, 1000), "deg": None}
_SECONDS: dict[str, _Factor] = {"s": Fraction(1), "ms": Fraction(1, 1000), "min": Fraction(60)}
_PIXELS: dict[str, _Factor] = {"px": Fraction(1)}

# The last two numbers bound a field of the settings, in SI: beyond them, probably another unit is meant.
NUMBER = Dimension("number", "0.4", "", {}, "", 1e-6, 10.0, bare=True)
FRACTION = Dimension(
    "fraction", "5 % or 0.05", "", {"%": Fraction(1, 100)}, "_probability", 0.0, 1.0, bare=True
)
LENGTH = Dimension("length", "80 mm", "m", _METRES, "_m", 1e-5, 10.0)
TIME = Dimension("time", "0.5 s", "s", _SECONDS, "_s", 1e-3, 60.0)
ANGLE = Dimension("angle", "30 deg", "rad", _RADIANS, "_rad", math.radians(1.0), math.tau)
RATE = Dimension("rate", "30 Hz", "Hz", {"Hz": Fraction(1), "kHz": Fraction(1000)}, "_hz", 0.1, 1000.0)
_SPEEDS = {**_powers(_METRES, "/s"), "km/h": Fraction(5, 18)}
SPEED = Dimension("speed", "0.5 m/s", "m/s", _SPEEDS, "_mps", 1e-3, 10.0)
ACCELERATION = Dimension("acceleration", "1 m/s2", "m/s2", _powers(_METRES, "/s2"), "_mps2", 1e-3, 100.0)
ANGULAR_SPEED = Dimension("angular speed", "30 deg/s", "rad/s", _powers(_RADIANS, "/s"), "_radps", 1e-3, 10.0)
ANGULAR_ACCELERATION = Dimension(
    "angular acceleration", "90 deg/s2", "rad/s2", _powers(_RADIANS, "/s2"), "_radps2", 1e-3, 100.0
)
PIXELS = Dimension("number of pixels", "2 px", "px", _PIXELS, "_px", 1e-3, 1e4)
PIXEL_AREA = Dimension("area in the image", "400 px2", "px2", _powers(_PIXELS, "2"), "_px2", 1e-3, 1e6)
PIXEL_SPEED = Dimension("speed in the image", "900 px/s", "px/s", _powers(_PIXELS, "/s"), "_pxps", 1e-3, 1e5)
PIXEL_ACCELERATION = Dimension(
    "acceleration in the image", "3000 px/s2", "px/s2", _powers(_PIXELS, "/s2"), "_pxps2", 1e-3, 1e6
)
PIXEL_AREA_RATE = Dimension(
    "rate of an area in the image", "20000 px2/s", "px2/s", _powers(_PIXELS, "2/s"), "_px2ps", 1e-3, 1e7
)
_PER_LENGTHS: dict[str, _Factor] = {"/m": Fraction(1), "/cm": Fraction(100), "/mm": Fraction(1000)}
PER_LENGTH = Dimension("number per length", "0.0025 /m", "/m", _PER_LENGTHS, "_per_m", 1e-5, 1.0)
TIME_PER_SPEED = Dimension("time per speed", "0.1 s2/m", "s2/m", {"s2/m": Fraction(1)}, "_s2pm", 1e-3, 10.0)
MASS = Dimension("mass", "2 kg", "kg", {"kg": Fraction(1), "g": Fraction(1, 1000)}, "_kg", 1e-3, 1000.0)
TORQUE = Dimension("torque", "87 Nm", "Nm", {"Nm": Fraction(1)}, "_nm", 1e-2, 1e5)
DIMENSIONS = tuple(item for item in tuple(globals().values()) if isinstance(item, Dimension))


def parse_quantity(text: str, dimension: Dimension, place: Place) -> float:
    """Return the SI value of ``text``.

    Raise ScenarioError at ``place`` unless ``text`` is a finite quantity.
    """
    value = _understood(text, dimension)
    if isinstance(value, dict):
        raise ScenarioError(place=place, **value)
    return value


@lru_cache(maxsize=4096)  # the scenarios of a space repeat most of their quantities
def _understood(text: str, dimension: Dimension) -> float | dict[str, str]:
    """Return the SI value of ``text``.

    If there is no such value, return the parts of an error message.
    """
    stripped = text.strip()
    matched = _NUMBER.match(stripped)
    if matched is None:
        return {"expected": dimension.expected, "got": shown(text), "hint": _units_hint("", dimension)}
    number, unit = matched.group(), normal_unit(stripped[matched.end() :])
    if not unit and not dimension.bare:
        got = f"{number}, which has no unit"
        return {"expected": dimension.expected, "got": got, "hint": _units_hint("", dimension)}
    if unit and unit not in dimension.units:
        return {"expected": dimension.expected, "got": shown(text), "hint": _units_hint(unit, dimension)}
    value = _si_value(number, dimension.units[unit] if unit else Fraction(1))
    if value is None:
        range_words = f"of at most {_LONGEST_NUMBER} characters and within the range of a 64-bit float"
        return {"expected": f"{dimension.expected}, {range_words}", "got": shown(text)}
    return value


def format_quantity(value: float, dimension: Dimension) -> str:
    """Return ``value`` in its SI unit as text, from which ``parse_quantity`` returns the same float."""
    number = repr(float(value))
    return f"{number} {dimension.si}" if dimension.si else number


def nice(value: float, dimension: Dimension) -> str:
    """Return ``value`` as text in the unit that people would choose.

    The text is converted back to exactly the same float.
    """
    if not dimension.units:
        return _digits(value)
    units = [unit for unit in dimension.units if not unit.startswith(_RARE)]
    # Among angles, degrees come first.
    units.sort(key=lambda unit: unit != "deg")
    written = [f"{_digits(_in_unit(value, dimension.units[unit]))} {unit}" for unit in units]
    exact = [text for text in written if parse_quantity(text, dimension, Place()) == value]
    size = {text: abs(float(text.split()[0])) for text in exact}
    handy = [text for text in exact if 1.0 <= size[text] < 1000.0]
    short = [text for text in exact if size[text] >= 0.01]
    return next(iter(handy + short + exact), f"{value!r} {dimension.si}")


def _in_unit(value: float, factor: Fraction | None) -> float:
    """Return an SI value converted to the unit with the factor ``factor``.

    A factor of None stands for degrees.
    """
    return math.degrees(value) if factor is None else float(Fraction(value) / factor)


def _digits(value: float) -> str:
    """Return a number with up to 12 digits."""
    return f"{value:.12g}".replace("e-0", "e-")


def normal_unit(unit: str) -> str:
    """Return a unit in the internal spelling: ``m/s^2``, ``m/s²`` and ``m / s2`` become ``m/s2``."""
    unit = "".join(unit.split()).replace("²", "2").replace("^2", "2").replace("°", "deg")
    return unit.removeprefix("1") if unit.startswith("1/") else unit


def shown(text: str) -> str:
    """Return ``text`` for a message, on one line and with at most 80 characters."""
    printable = "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in " ".join(text.split()))
    if not printable:
        return "nothing"
    return printable if len(printable) <= 80 else printable[:77] + "..."


def _units_hint(unit: str, dimension: Dimension) -> str:
    """Return a hint that lists the allowed units, and that suggests the unit that resembles ``unit``."""
    if not dimension.units:
        return "a number without a unit"
    if re.search(r"to[+-]?\.?[0-9]", unit):
        return 'a range, which only a space may have, begins with "from"'
    return f"{near_miss(unit, dimension.units, most=2)} allowed units: {', '.join(dimension.units)}".strip()


def _si_value(number: str, factor: _Factor) -> float | None:
    """Return the product of ``number`` and ``factor``, rounded once.

    The result is None if the product is not finite.
    """
    exponent = number.lower().partition("e")[2]
    # The exponent is checked before anything is computed, because 10**1000000000 would not end.
    if len(number) > _LONGEST_NUMBER or (exponent and abs(int(exponent)) > _LARGEST_EXPONENT):
        return None
    try:
        if factor is None:
            magnitude = math.radians(float(number))
        elif factor == 1:
            magnitude = float(number)  # which rounds once as well
        else:
            magnitude = float(Fraction(number) * factor)
    except OverflowError:
        return None
    if not math.isfinite(magnitude):
        return None
    # Unlike a float, a fraction has no negative zero, and files must be read back bit for bit.
    return math.copysign(magnitude, -1.0) if number.startswith("-") else magnitude
