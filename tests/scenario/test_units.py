from __future__ import annotations

import math
from decimal import Decimal, localcontext

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from safety_harness.base.exceptions import Place, ScenarioError
from safety_harness.scenario import units
from safety_harness.scenario.units import Dimension, format_quantity, normal_unit, parse_quantity

PLACE = Place(line=3, field="speed")
DIMENSIONS = [value for value in vars(units).values() if isinstance(value, Dimension)]
DIMENSIONED = [dimension for dimension in DIMENSIONS if not dimension.bare]
by_name = {"argvalues": DIMENSIONS, "ids": lambda dimension: dimension.name}
unhurried = hypothesis_settings(deadline=None, max_examples=50)
decimals = st.from_regex(r"[+-]?[0-9]{1,12}(\.[0-9]{1,12})?", fullmatch=True)
numbers = st.floats(allow_nan=False, allow_infinity=False)


def refusal(text: str, dimension: Dimension) -> ScenarioError:
    with pytest.raises(ScenarioError) as caught:
        parse_quantity(text, dimension, PLACE)
    assert caught.value.place == PLACE
    return caught.value


@pytest.mark.parametrize(
    ("unit", "exponent", "dimension"),
    [
        ("m", 0, units.LENGTH),
        ("cm", -2, units.LENGTH),
        ("mm", -3, units.LENGTH),
        ("ms", -3, units.TIME),
        ("mm/s", -3, units.SPEED),
        ("mm/s2", -3, units.ACCELERATION),
        ("mrad", -3, units.ANGLE),
        ("kHz", 3, units.RATE),
        ("%", -2, units.FRACTION),
        ("/mm", 3, units.PER_LENGTH),
        ("px", 0, units.PIXELS),
    ],
)
@unhurried
@given(number=decimals)
def test_a_decimal_unit_only_shifts_the_point(
    unit: str, exponent: int, dimension: Dimension, number: str
) -> None:
    # Python reads a literal as the float nearest to it: the oracle for "rounded once".
    assert parse_quantity(f"{number} {unit}", dimension, PLACE) == float(f"{number}e{exponent}")


@unhurried
@given(number=decimals)
def test_kilometres_an_hour_are_rounded_once(number: str) -> None:
    with localcontext() as context:
        context.prec = 60
        nearest = float(Decimal(number) / Decimal("3.6"))
    assert parse_quantity(f"{number} km/h", units.SPEED, PLACE) == nearest


@unhurried
@given(number=decimals)
def test_degrees_go_through_math_radians(number: str) -> None:
    radians = math.radians(float(number))
    assert parse_quantity(f"{number} deg", units.ANGLE, PLACE) == radians
    assert parse_quantity(f"{number} deg/s", units.ANGULAR_SPEED, PLACE) == radians
    assert parse_quantity(f"{number} deg/s2", units.ANGULAR_ACCELERATION, PLACE) == radians


@pytest.mark.parametrize("dimension", **by_name)
@unhurried
@given(value=numbers)
def test_what_is_written_is_read_back_to_the_bit(dimension: Dimension, value: float) -> None:
    assert repr(parse_quantity(format_quantity(value, dimension), dimension, PLACE)) == repr(value)


@pytest.mark.parametrize("dimension", **by_name)
def test_the_example_in_a_message_is_a_quantity_of_its_kind(dimension: Dimension) -> None:
    for example in dimension.example.split(" or "):
        assert parse_quantity(example, dimension, PLACE) > 0.0


@pytest.mark.parametrize("dimension", **by_name)
def test_the_si_unit_has_the_factor_one(dimension: Dimension) -> None:
    assert parse_quantity(f"0.3 {dimension.si}", dimension, PLACE) == 0.3


@pytest.mark.parametrize(
    "text", ["2 m/s2", "2 m/s^2", "2 m/s²", "2m/s2", " 2  m / s2 ", "2.0e0 m/s2", "+2. m/s2"]
)
def test_spellings_of_one_quantity(text: str) -> None:
    assert parse_quantity(text, units.ACCELERATION, PLACE) == 2.0


def test_a_degree_sign_and_a_reciprocal_are_understood() -> None:
    assert parse_quantity("30°", units.ANGLE, PLACE) == math.radians(30.0)
    assert parse_quantity("0.0025 1/m", units.PER_LENGTH, PLACE) == 0.0025


@pytest.mark.parametrize("dimension", DIMENSIONED, ids=lambda dimension: dimension.name)
@unhurried
@given(value=numbers)
def test_a_number_without_a_unit_is_refused(dimension: Dimension, value: float) -> None:
    error = refusal(repr(value), dimension)
    assert error.expected == dimension.expected
    assert error.got == f"{value!r}, which has no unit"
    assert all(unit in error.hint for unit in dimension.units)


def test_the_refusal_of_a_bare_number_reads_well() -> None:
    error = refusal("80", units.LENGTH)
    assert f"{error}" == (
        "<input>:3: speed: expected a length such as 80 mm; got 80, which has no unit "
        "(allowed units: m, cm, mm)"
    )


@pytest.mark.parametrize("dimension", DIMENSIONED, ids=lambda dimension: dimension.name)
@pytest.mark.parametrize("other", DIMENSIONED, ids=lambda dimension: dimension.name)
def test_a_unit_of_another_dimension_is_refused(dimension: Dimension, other: Dimension) -> None:
    if dimension is not other:
        assert not set(dimension.units) & set(other.units)
        assert refusal(f"1 {other.si}", dimension).got == f"1 {other.si}"


@pytest.mark.parametrize(
    ("text", "dimension", "suggestion"),
    [
        ("80 mn", units.LENGTH, '"mm"'),
        ("80 MM", units.LENGTH, '"mm"'),
        ("30 hz", units.RATE, '"Hz"'),
        ("30 degs", units.ANGLE, '"deg"'),
        ("5 kmh", units.SPEED, '"km/h"'),
        ("1 m/ss", units.ACCELERATION, '"m/s2"'),
    ],
)
def test_a_misspelt_unit_gets_a_suggestion_and_the_list(
    text: str, dimension: Dimension, suggestion: str
) -> None:
    hint = refusal(text, dimension).hint
    assert hint.startswith("did you mean ")
    assert suggestion in hint.split("?")[0]
    assert hint.endswith("allowed units: " + ", ".join(dimension.units))


@pytest.mark.parametrize("dimension", **by_name)
@pytest.mark.parametrize(
    "number", ["nan", "inf", "-inf", "NaN", ".inf", "1e999", "-1e308000", "1e999999999999"]
)
def test_only_finite_numbers_are_numbers(dimension: Dimension, number: str) -> None:
    text = f"{number} {dimension.si}".strip()
    assert refusal(text, dimension).got == text


@pytest.mark.parametrize(
    "text", ["", "  ", "mm", "eighty mm", "0x10 mm", "1,200 mm", "1_000 mm", "٣ mm", "- 3 mm"]
)
def test_what_is_not_a_number_is_refused(text: str) -> None:
    assert refusal(text, units.LENGTH).expected == "a length such as 80 mm"


def test_a_number_of_absurd_length_is_refused_and_shown_short() -> None:
    assert len(refusal("1" * 5000 + " mm", units.LENGTH).got) <= 80


@unhurried
@given(text=st.text(max_size=30))
def test_any_text_is_a_finite_quantity_or_refused(text: str) -> None:
    for dimension in (units.LENGTH, units.NUMBER, units.ANGLE):
        try:
            value = parse_quantity(text, dimension, PLACE)
        except ScenarioError:
            continue
        assert math.isfinite(value)


@unhurried
@given(unit=st.text(max_size=10))
def test_the_normal_spelling_is_stable(unit: str) -> None:
    once = normal_unit(unit)
    assert normal_unit(once) == once


def test_a_range_without_from_gets_a_hint() -> None:
    for text in ("200 ms to 1 s", "0.2 to 1 s", "1 s to .5 s"):
        assert refusal(text, units.TIME).hint == 'a range, which only a space may have, begins with "from"'
