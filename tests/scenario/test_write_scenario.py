from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scenario_strategies import RECORDINGS, scenarios, settings

from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.scenario.codec import plain_text, scalar_text
from safety_harness.scenario.model import Claim, MovingHand, OffsetStart, Scenario, Verdict
from safety_harness.scenario.nodes import Mapping, Node, Scalar, parse_tree
from safety_harness.scenario.read import parse_scenario
from safety_harness.scenario.write import node_of, text_of, tree_of, write_scenario

FILE = Path("example.yaml")
PLAIN = Scenario(
    name="example",
    title="nothing but defaults",
    about="",
    duration_s=1.0,
    seed=0,
    start=OffsetStart(offset_in_base_m=(0.0, 0.0, 0.0)),
    hands=(),
    avoider="opposite pose",
    claims=(Claim(sentence="gain switch reached", expected=Verdict.HOLDS),),
)


def plain(node: Node) -> object:
    """Return the values of a tree without their lines; a list of pairs for a mapping, as order counts."""
    if isinstance(node, Scalar):
        return node.text
    if isinstance(node, Mapping):
        return [(key.text, plain(value)) for key, value in node.entries]
    return tuple(map(plain, node.items))


quick = hypothesis_settings(deadline=None, max_examples=50, suppress_health_check=[HealthCheck.too_slow])


@quick
@given(scenarios())
def test_a_written_scenario_reads_back_as_the_same(scenario: Scenario) -> None:
    again = parse_scenario(write_scenario(scenario), FILE, RECORDINGS)
    assert again == scenario


@quick
@given(scenarios())
def test_no_bit_of_a_number_is_lost(scenario: Scenario) -> None:
    again = parse_scenario(write_scenario(scenario), FILE, RECORDINGS)
    # Equality takes -0.0 for 0.0; the digits that repr shows do not.
    assert repr(again.settings) == repr(scenario.settings)
    assert repr(again.start) == repr(scenario.start)
    for hand, hand_again in zip(scenario.hands, again.hands, strict=True):
        if isinstance(hand, MovingHand):
            assert repr(hand_again) == repr(hand)


@quick
@given(scenarios())
def test_writing_what_was_read_gives_the_same_text(scenario: Scenario) -> None:
    text = write_scenario(scenario)
    assert write_scenario(parse_scenario(text, FILE, RECORDINGS)) == text


@quick
@given(scenarios())
def test_the_tree_of_a_scenario_is_the_tree_of_its_text(scenario: Scenario) -> None:
    tree = tree_of(scenario)
    assert plain(node_of(tree)) == plain(parse_tree(text_of(tree), FILE))


@quick
@given(st.text())
def test_a_text_in_quotes_is_the_text_again(text: str) -> None:
    assert plain_text(scalar_text(text)) == text


@quick
@given(settings)
def test_a_text_with_all_settings_does_not_depend_on_the_defaults(chosen: Settings) -> None:
    chosen = replace(chosen, clock=DEFAULTS.clock)
    text = write_scenario(replace(PLAIN, settings=chosen), all_settings=True)
    assert parse_scenario(text, FILE).settings == chosen
    for group in ("clock", "cell", "hand filter", "servo", "motion", "braking"):
        assert f"  {group}:" in text


def test_defaults_are_left_out_so_that_a_file_shows_what_is_special() -> None:
    text = write_scenario(PLAIN)
    assert "settings" not in text
    assert "camera" not in text
    assert parse_scenario(text, FILE) == PLAIN


def test_every_default_is_a_value_that_a_file_may_give() -> None:
    assert parse_scenario(write_scenario(PLAIN, all_settings=True), FILE).settings == DEFAULTS


def test_numbers_are_written_in_si_with_their_shortest_exact_digits() -> None:
    start = OffsetStart(offset_in_base_m=(0.08, 0.1 + 0.2, 1e-5))
    assert "offset: [0.08 m, 0.30000000000000004 m, 1e-05 m]" in write_scenario(replace(PLAIN, start=start))
