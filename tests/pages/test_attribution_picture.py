"""Each group of violations is a bar as long as its share."""

from __future__ import annotations

from xml.etree import ElementTree

from safety_harness.claims.properties.base import Unit
from safety_harness.extensions.attribution.attribute import Attribution, AttributionAnswer
from safety_harness.extensions.attribution.tally import AttributionTally
from safety_harness.extensions.pages.attributions import LONGEST_PX, draw_attributions
from safety_harness.scenario.model import Claim, Verdict


def of(answer: AttributionAnswer) -> Attribution:
    claim = Claim(sentence="hand distance never below 50 mm", expected=Verdict.HOLDS)
    return Attribution(scenario="one", claim=claim, unit=Unit.LENGTH, answer=answer, margin=-0.01)


def test_bars_are_as_long_as_the_shares_and_said_in_words() -> None:
    tally = AttributionTally.from_attributions(
        [of(AttributionAnswer.UNAVOIDABLE)] * 3 + [of(AttributionAnswer.NOT_ATTRIBUTED)]
    )
    root = ElementTree.fromstring(draw_attributions(tally.groups))
    widths = [float(bar.get("width", "")) for bar in root.iter("rect")]
    assert widths == [0.75 * LONGEST_PX, 0.25 * LONGEST_PX]
    words = [text.text for text in root.iter("text")]
    assert words == ["4 violations", "unavoidable", "3 (75%)", "not attributed", "1 (25%)"]
    assert root.findtext("desc") == "of 4: 3 unavoidable, 1 not attributed"


def test_nothing_is_no_bar() -> None:
    root = ElementTree.fromstring(draw_attributions({}))
    assert not list(root.iter("rect"))
    assert [text.text for text in root.iter("text")] == ["0 violations"]
