from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

from made_up_evidence import claims, evidence

from safety_harness.extensions.assurance.certification.evidence import Bound
from safety_harness.extensions.assurance.certification.figures import (
    bounds_figure,
    margins_figure,
    separation_figure,
)


def texts(svg: str) -> str:
    return " ".join("".join(one.itertext()) for one in ElementTree.fromstring(svg).iter("text"))


def test_every_stratum_and_the_target_stand_in_the_figure_of_bounds() -> None:
    drawn = bounds_figure(claims()[0])
    assert "seen" in texts(drawn)
    assert "unseen hand" in texts(drawn)
    assert "target 0.2 %" in texts(drawn)
    assert "0.31 % to 1.71 %" in drawn  # said to a screen reader


def test_what_has_no_bound_and_no_margin_is_not_drawn() -> None:
    never = claims()[4]
    assert bounds_figure(never) == ""
    assert margins_figure(never) == ""
    assert separation_figure(()) == ""


def test_a_single_run_can_be_drawn() -> None:
    claim = claims()[0]
    one = replace(
        claim.outcomes[0],
        runs=1,
        margins_si=(0.01,),
        shares=(1.0,),
        bound=Bound(lower=1.0, upper=1.0, confidence=0.99, method="exact"),
    )
    claim = replace(claim, target=None, outcomes=(one,))
    assert "least 10.0 mm" in margins_figure(claim)
    assert bounds_figure(claim)


def test_the_terms_of_the_separation_distance_are_named() -> None:
    drawn = separation_figure(evidence().separation)
    assert "Sh" in texts(drawn)
    assert "1050 mm needed, 310 mm there" in drawn
