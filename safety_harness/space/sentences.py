"""Read distributions from the texts that replace a value in a file, such as ``from 0.5 m/s to 2 m/s``."""

from __future__ import annotations

import re

from safety_harness.base.exceptions import near_miss
from safety_harness.scenario.fields import Field
from safety_harness.scenario.units import DIMENSIONS, NUMBER, normal_unit, parse_quantity, shown
from safety_harness.space.distributions import LEAST_MASS, TruncatedNormal, Uniform

# Choices that bound the size of a space which a file can ask for.
MOST_OPTIONS = 100
MOST_TIMES = 20

_DIMENSIONS = {unit: dimension for dimension in DIMENSIONS for unit in dimension.units}
_NUMBER = re.compile(r"[+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?")
_UNIFORM = re.compile(r"from (.+?) to (.+)")
_NORMAL = re.compile(r"normal (.+?) ?(?:\+-|\+/-|±) ?(.+?) from (.+?) to (.+)")
_TIMES = re.compile(r"(?:from )?([0-9]{1,9})(?: to ([0-9]{1,9}))? times?")


def sentence(field: Field, text: str) -> Uniform | TruncatedNormal | None:
    """Return the distribution that a text describes.

    Return None unless the text begins with "from" or "normal".
    """
    first = text.partition(" ")[0]
    if first == "from":
        return _uniform(field, text)
    return _normal(field, text) if first == "normal" else None


def times(field: Field) -> tuple[int, int]:
    """Return the smallest and largest number in a text such as ``from 1 to 4 times``."""
    expected = f'how often, such as "from 1 to 4 times", at most {MOST_TIMES}'
    matched = _TIMES.fullmatch(" ".join(field.scalar(expected).split()))
    if matched is None:
        raise field.error(expected)
    least, most = int(matched[1]), int(matched[2] or matched[1])
    if not least <= most <= MOST_TIMES or most == 0:
        raise field.error(expected)
    return least, most


def fixed_quantity(field: Field, text: str | None = None) -> tuple[float, str]:
    """Return a quantity in SI, and its SI unit.

    The unit in the text determines the dimension.

    Args:
        field: The field, for error messages.
        text: The text.  None means the text of the field.

    """
    text = field.scalar("a quantity such as 80 mm") if text is None else text
    number = _NUMBER.match(text.strip())
    unit = normal_unit(text.strip()[number.end() :]) if number else ""
    if number is None or (unit and unit not in _DIMENSIONS):
        expected = "a quantity such as 80 mm or 0.5 m/s"
        raise field.error(expected, got=shown(text), hint=near_miss(unit, _DIMENSIONS))
    dimension = _DIMENSIONS[unit] if unit else NUMBER
    return parse_quantity(text, dimension, field.place), dimension.si


def _uniform(field: Field, text: str) -> Uniform:
    """Return the uniform distribution that a text describes."""
    matched = _UNIFORM.fullmatch(text)
    if matched is None:
        raise field.error('both ends, such as "from 0.5 m/s to 2 m/s"')
    (low, high), unit = _alike(field, matched[1], matched[2])
    if not low < high:
        hint = f"from {matched[2]} to {matched[1]}" if low > high else ""
        raise field.error("a lower end, then a higher one", hint=hint)
    return Uniform(low, high, unit)


def _normal(field: Field, text: str) -> TruncatedNormal:
    """Return the truncated normal distribution that a text describes."""
    matched = _NORMAL.fullmatch(text)
    if matched is None:
        example = "normal 1 m/s +- 0.2 m/s from 0.5 m/s to 2 m/s"
        raise field.error(f'a mean, a deviation and both ends, such as "{example}"')
    (mean, std, low, high), unit = _alike(field, *matched.groups())
    if not (low < high and std > 0.0):
        raise field.error("a deviation above zero, and a lower end, then a higher one")
    try:
        return TruncatedNormal(mean, std, low, high, unit)
    except ValueError:
        expected = f"at least {LEAST_MASS:g} of the normal distribution between its ends"
        raise field.error(expected) from None


def _alike(field: Field, *texts: str) -> tuple[tuple[float, ...], str]:
    """Return the quantities in ``texts`` as numbers in SI, and their SI unit.

    All texts must have the same unit.
    """
    quantities = [fixed_quantity(field, text) for text in texts]
    if len({unit for _, unit in quantities}) > 1:
        hint = "a number alone has no unit: from 0.5 m/s to 2 m/s"
        raise field.error("quantities of one kind, each with its unit", hint=hint)
    return tuple(value for value, _ in quantities), quantities[0][1]


def options_of(field: Field, text: str) -> tuple[str, ...]:
    """Return the options in a text of the form ``A, B``, without converting them."""
    options = tuple(option.strip() for option in text.split(","))
    _refuse_options(field, options)
    if not all(options):
        raise field.error('two or more, such as "one of 20 mm, 50 mm"')
    return options


def listed_options(field: Field) -> tuple[Field, ...]:
    """Return the options that a list contains."""
    options = field.items(f"a list of 2 to {MOST_OPTIONS} options")
    _refuse_options(field, tuple(range(len(options))))
    return options


def _refuse_options(field: Field, options: tuple[object, ...]) -> None:
    """Raise ScenarioError unless there are 2 to MOST_OPTIONS different options."""
    if not 2 <= len(options) <= MOST_OPTIONS:
        raise field.error(f"from 2 to {MOST_OPTIONS} options", got=f"{len(options)}")
    if len(set(options)) < len(options):
        raise field.error("options that differ", hint="for one that is more probable: one of, chances")
