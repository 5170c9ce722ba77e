"""What cannot be said is refused where it is written, with what to write instead."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, nan
from typing import Any

import numpy as np
import pytest

from safety_harness.base.exceptions import FormulaError
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.language import (
    always,
    cm,
    deg,
    eventually,
    hand_distance,
    initially,
    m,
    mm,
    mm_per_s,
    s,
    servoing,
    stopped,
    tcp_speed,
    whenever,
)
from safety_harness.claims.properties.base import Unit

hand: Any = hand_distance  # so that mistakes can be written down without the type checker's objection
WRONG: dict[str, Callable[[], object]] = {
    "parentheses": lambda: hand_distance() > mm(50) | stopped(),  # type: ignore[operator]
    "a run$|without a run": lambda: mm(30) < hand_distance() < mm(50),
    "without a run": lambda: bool(always(stopped())),
    r'the signal "hand distance" alone': lambda: always(hand()),
    'signal "TCP speed" alone': lambda: servoing() & tcp_speed(),  # type: ignore[operator]
    "a length such as 80 mm.*got 50": lambda: hand() > 50,
    "got 3 deg": lambda: hand_distance() > deg(3),
    "a time such as s": lambda: always(stopped(), window=mm(3)),
    "<, <=, > or >=": lambda: hand_distance() == mm(3),
    "a finite number of mm; got nan": lambda: mm(nan),
    "a finite number of mm; got inf": lambda: mm(inf),
    "a finite number of mm; got '5'": lambda: mm("5"),  # type: ignore[arg-type]
    "a finite number of s; got True": lambda: s(True),
    "a window from": lambda: always(servoing(), window=(s(2), s(1))),
    "to a later one": lambda: always(servoing(), window=s(0)),
    "at least 0 s": lambda: always(servoing(), window=(s(-1), s(1))),
    "at the beginning of a claim": lambda: ~whenever(stopped()).then(servoing()),
    "of the whole run": lambda: eventually(initially(servoing())),
    "one kind of margin": lambda: FormulaClaim((hand_distance() > mm(3)) | (tcp_speed() < mm_per_s(3))),
    "a formula such as": lambda: FormulaClaim("always stopped"),  # type: ignore[arg-type]
    'beside "then"': lambda: whenever(stopped()).then(hand()),
}


@pytest.mark.parametrize("told", WRONG)
def test_a_mistake_says_what_to_write(told: str) -> None:
    with pytest.raises(FormulaError, match=told):
        WRONG[told]()


def test_a_limit_is_what_it_is_in_whatever_unit() -> None:
    assert (hand_distance() > mm(50)) == (hand_distance() > cm(5)) == (m(0.05) < hand_distance())
    assert (hand_distance() > mm(50)) != (hand_distance() >= mm(50))
    assert mm(np.float64(50.0)) == mm(50)
    assert mm(1) != s(0.001)
    assert str(hand_distance() > cm(5.0)) == "hand distance > 5 cm"


def test_a_claim_says_its_sentence_and_its_unit() -> None:
    claim = FormulaClaim(whenever(hand_distance() < mm(300)).then(tcp_speed() < mm_per_s(100)))
    assert claim.sentence == "whenever hand distance < 300 mm then TCP speed < 100 mm/s"
    assert claim.unit is Unit.SPEED
    assert FormulaClaim(stopped()).unit is Unit.COUNT


def test_a_trigger_may_mix_what_has_no_margin_there() -> None:
    near_and_fast = (hand_distance() < mm(300)) & (tcp_speed() > mm_per_s(100))
    assert FormulaClaim(whenever(near_and_fast).then(stopped())).unit is Unit.COUNT
