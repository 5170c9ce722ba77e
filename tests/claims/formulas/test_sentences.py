"""A sentence and the formula that it says are the same thing; mistakes are named with their column."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from safety_harness.base.exceptions import FormulaError, Place
from safety_harness.claims.formulas.formula import (
    Always,
    Comparison,
    Eventually,
    Formula,
    Globally,
    Initially,
    Not,
    Relation,
    Truth,
    Until,
    conjunction,
    disjunction,
    parts_of,
)
from safety_harness.claims.formulas.language import (
    always,
    cm,
    deg_per_s,
    eventually,
    hand_distance,
    image_error,
    initially,
    joint_speed,
    mm,
    mm_per_s,
    ms,
    object_visible,
    repulsing,
    s,
    servoing,
    stopped,
    tcp_speed,
    whenever,
)
from safety_harness.claims.formulas.measures import Flag
from safety_harness.claims.formulas.parse import looks_like_formula, parse_formula
from safety_harness.claims.formulas.quantities import Span, quantity
from safety_harness.claims.formulas.signals import SIGNALS
from safety_harness.scenario.units import TIME

numbers = st.floats(0.0, 1.0) | st.integers(0, 6)


@st.composite
def atoms(draw: st.DrawFn) -> Formula:
    signal = draw(st.sampled_from(SIGNALS))
    if isinstance(signal, Flag):
        return Truth(signal)
    assert signal.dimension is not None
    unit = draw(
        st.sampled_from(["", *signal.dimension.units] if signal.dimension.bare else [*signal.dimension.units])
    )
    limit = quantity(draw(numbers), unit, signal.dimension)
    return Comparison(signal, draw(st.sampled_from(list(Relation))), limit)


@st.composite
def spans(draw: st.DrawFn) -> Span | None:
    unit = draw(st.sampled_from(["ms", "s", "min"]))
    begin = draw(st.just(0.0) | st.floats(0.0, 10.0))
    end = draw(st.floats(begin, 100.0, exclude_min=True))
    if draw(st.booleans()):
        return None
    return Span(quantity(begin, unit, TIME), quantity(max(end, begin + 0.001), unit, TIME))


def built(inner: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    return (
        st.builds(Not, inner)
        | st.builds(conjunction, inner, inner)
        | st.builds(disjunction, inner, inner)
        | st.builds(Always, inner, spans())
        | st.builds(Eventually, inner, spans())
        | st.builds(Until, inner, inner, spans())
    )


inner = st.recursive(atoms(), built, max_leaves=6)
tops = inner | st.builds(Globally, inner, inner) | st.builds(Initially, inner)
claims = tops | st.builds(conjunction, tops, tops)


def mixes(formula: Formula) -> bool:
    try:
        parts_of(formula)
    except FormulaError:
        return True
    return False


@settings(max_examples=300, deadline=None)
@given(claims)
def test_what_a_formula_is_written_as_is_read_as_that_formula(formula: Formula) -> None:
    if mixes(formula):
        with pytest.raises(FormulaError, match=r"one kind of margin|which say when"):
            parse_formula(str(formula))
        return
    again = parse_formula(str(formula))
    assert again == formula
    assert str(again) == str(formula)


@pytest.mark.parametrize(
    ("sentence", "formula"),
    [
        ("always hand distance > 50 mm", always(hand_distance() > mm(50))),
        ("hand distance>50mm", hand_distance() > mm(50)),
        ("ALWAYS  Hand Distance ≥ 5 cm", always(hand_distance() >= cm(5))),
        (
            "whenever hand distance < 300 mm then within 200 ms TCP speed < 100 mm/s",
            whenever(hand_distance() < mm(300)).then(eventually(tcp_speed() < mm_per_s(100), window=ms(200))),
        ),
        (
            "repulsing until hand distance > 300 mm within 4 s",
            repulsing().until(hand_distance() > mm(300), window=s(4)),
        ),
        ("always for 2 s not stopped", always(~stopped(), window=s(2))),
        ("always from 0.1 s to 0.5 s stopped", always(stopped(), window=(s(0.1), s(0.5)))),
        ("eventually from 1 s to 2 s stopped", eventually(stopped(), window=(s(1), s(2)))),
        ("always (servoing or repulsing)", always(servoing() | repulsing())),
        ("(always servoing) or (eventually stopped)", always(servoing()) | eventually(stopped())),
        ("eventually within 2 s stopped", eventually(stopped(), window=s(2))),
        ("eventually (within 2 s stopped)", eventually(eventually(stopped(), window=s(2)))),
        ("not always servoing", ~always(servoing())),
        ("initially not object visible", initially(~object_visible())),
        (
            "image error < 0.002 and joint speed <= 30 deg/s",
            (image_error() < 0.002) & (joint_speed() <= deg_per_s(30)),
        ),
        (
            "whenever repulsing then repulsing until servoing within 4 s",
            whenever(repulsing()).then(repulsing().until(servoing(), window=s(4))),
        ),
    ],
)
def test_a_sentence_says_what_python_says(sentence: str, formula: Formula) -> None:
    assert parse_formula(sentence) == formula
    assert parse_formula(str(formula)) == formula


@pytest.mark.parametrize(
    ("sentence", "column", "word", "hint"),
    [
        ("always hand distence > 50 mm", 8, "hand distence", 'did you mean "hand distance"'),
        ("alwys hand distance > 50 mm", 1, "alwys hand distance", "hand distance"),
        ("always hand distance > 50", 24, "50", "allowed units: m, cm, mm"),
        ("always hand distance > 50 mm/s", 24, "50 mm/s", 'did you mean "mm"?'),
        ("always hand distance > fifty mm", 24, "fifty", "allowed units"),
        ("always hand distance = 50 mm", 22, "=", ""),
        ("always stopped > 3 mm", 16, ">", ""),
        ("always servoing and stopped", 17, "and", '"always (...)"'),
        ("servoing and stopped or repulsing", 22, "or", "(a and b) or c"),
        ("servoing until stopped until repulsing", 24, "until", "(a until b) until c"),
        ("servoing and always stopped", 14, "always", "(always ...)"),
        ("within 5 mm servoing", 8, "5 mm", "allowed units: s, ms, min"),
        ("within 0 s servoing", 8, "0 s", ""),
        ("eventually from 3 s to 1 s servoing", 24, "1 s", ""),
        ("eventually from -1 s to 1 s servoing", 12, "from", ""),
        ("not whenever servoing then stopped", 1, "", "of the whole run already"),
        ("servoing) and stopped", 9, ")", ""),
        ("always (servoing", None, "the end", ""),
        ("whenever servoing", None, "the end", ""),
        ("always", None, "the end", "all of them: safety-harness claims"),
        ("always servoing 5", 17, "5", ""),
        ("always + servoing", 8, "+", ""),
        ("not " * 40 + "servoing", 161, "servoing", ""),
        ("(" * 40 + "servoing", 32, "(", ""),
        ("within 1 s " * 40 + "servoing", None, "within", ""),
    ],
)
def test_a_mistake_is_named_with_its_column(sentence: str, column: int | None, word: str, hint: str) -> None:
    with pytest.raises(FormulaError) as caught:
        parse_formula(sentence, Place(file=Path("a.yaml"), line=7))
    assert str(caught.value.place) == "a.yaml:7"
    assert word in caught.value.got
    if column is not None:
        assert f"at column {column} of" in caught.value.got
    assert hint in caught.value.hint


WORDS = (
    "always eventually within whenever then until and or not ( ) > < hand distance stopped 5 mm s from to for"
)


@given(st.text(max_size=60) | st.lists(st.sampled_from(WORDS.split()), max_size=12).map(" ".join))
def test_any_text_is_a_formula_or_a_mistake_that_is_told(text: str) -> None:
    try:
        formula = parse_formula(text)
    except FormulaError:
        return
    assert parse_formula(str(formula)) == formula


@pytest.mark.parametrize("sentence", ["stopped", "Hand Tracked", "initially x", "a > b", "x until y", "(a)"])
def test_these_mean_to_be_formulas(sentence: str) -> None:
    assert looks_like_formula(sentence)


@pytest.mark.parametrize(
    "sentence",
    ["joint speed within limits", "hand distance never below 50mm", "starts retreating within 100 ms", ""],
)
def test_these_mean_to_be_claims_of_the_catalogue(sentence: str) -> None:
    assert not looks_like_formula(sentence)
