"""What is wrong in any avoider decides, what is unlike the yardsticks is reported, harmless is neither."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from faulty_avoiders import (
    HARMLESS,
    Answers,
    Ask,
    Faulty,
    HonestNoise,
    avoider_named,
    base_named,
    network,
)

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.asking import BatchAvoider
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.simple import OppositePose
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS
from safety_harness.extensions.lab.commands.evaluate import evaluate
from safety_harness.extensions.lab.evaluate_job import DATA
from safety_harness.extensions.lab.scoring import score as scoring
from safety_harness.extensions.lab.scoring.figures import number_step_m
from safety_harness.extensions.lab.scoring.findings import findings
from safety_harness.extensions.lab.scoring.regions import named_regions
from safety_harness.extensions.lab.scoring.repeats import Subject
from safety_harness.extensions.lab.scoring.scorecard import UNSAFE, UNSAFE_OF_NETWORK, Kind, ScoreFinding
from safety_harness.space.regions import paper_seen

SEEN = named_regions(paper_seen(DEFAULTS), DEFAULTS)[:1]
MANY = scoring.Counts(first=8_000, segments=100, alone=50, sample=100)
Found = Callable[[Callable[[], BatchAvoider]], tuple[ScoreFinding, ...]]
Array = Any


@pytest.fixture(scope="module", autouse=True)
def _networks_answer_once() -> Iterator[None]:
    """What all changes ask of one network is computed once: that it repeats itself is tested elsewhere."""
    known: dict[tuple[str, ...], Answers] = {}
    propose_many = LearnedAvoider.propose_many

    def remembered(self: LearnedAvoider, *question: Array) -> Answers:
        key = (self.name, *(hashlib.sha256(np.ascontiguousarray(one)).hexdigest() for one in question))
        if key not in known:
            known[key] = propose_many(self, *question)
        positions, spreads = known[key]
        return positions.copy(), spreads.copy()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(LearnedAvoider, "propose_many", remembered)
        yield


@pytest.fixture(scope="module")
def found() -> Found:
    """The findings on what is made."""
    yardsticks = scoring.yardsticks(SEEN, seed=1, counts=MANY)

    def of(make: Callable[[], BatchAvoider]) -> tuple[ScoreFinding, ...]:
        return findings(scoring.score(Subject.made_by(make, "x"), SEEN, seed=1, counts=MANY), yardsticks)

    return of


@pytest.fixture(autouse=True)
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """No avoider here changes with the time."""
    monkeypatch.setattr(scoring, "LATER_S", 0.0)


def changed(change: Callable[[Array, Array], tuple[Array, Array]], base: str = "network") -> BatchAvoider:
    below = HonestNoise() if base == "noise" else base_named(base)

    def ask(hands: Array, tcps: Array, seeds: Array) -> Answers:
        return change(*below.propose_many(hands, tcps, seeds))

    return Faulty(below, ask, "changed")


def other_seeds(ask: Ask, more: int) -> Ask:
    return lambda hands, tcps, seeds: ask(hands, tcps, seeds + np.uint64(more))


def rounded(step_m: float) -> Callable[[Array, Array], tuple[Array, Array]]:
    return lambda positions, spreads: (np.round(positions / step_m) * step_m, spreads)


def of_format(kind: type[np.floating[Any]]) -> Callable[[Array, Array], tuple[Array, Array]]:
    return lambda positions, spreads: (
        positions.astype(kind).astype(float),
        spreads.astype(kind).astype(float),
    )


def down(positions: Array, spreads: Array) -> tuple[Array, Array]:
    return np.floor(positions / 0.00025) * 0.00025, spreads


def one_more_pass(ask: Ask) -> Ask:
    """The mean of 50 passes and one more of another seed, about."""

    def answers(hands: Array, tcps: Array, seeds: Array) -> Answers:
        (positions, spreads), (more, _) = ask(hands, tcps, seeds), ask(hands, tcps, seeds + np.uint64(7))
        return positions + (more - positions) / 51.0, spreads

    return answers


CHANGES: dict[str, Callable[[], BatchAvoider]] = {
    **{
        f"{base} rounded to {step_m * 1e3:g} mm": lambda base=base, step_m=step_m: changed(
            rounded(step_m), base
        )
        for base in ("network", "optimum")
        for step_m in (1e-6, 1e-5, 1e-4, 0.00025, 0.0005)
    },
    "rounded to 1 mm": lambda: changed(rounded(0.001)),
    "rounded to a 4096th": lambda: changed(rounded(2.0**-12)),
    "rounded down": lambda: changed(down),
    "half precision": lambda: changed(of_format(np.float16)),
    "half precision of the optimum": lambda: changed(of_format(np.float16), "optimum"),
    "half precision with a spread": lambda: changed(of_format(np.float16), "noise"),
    "single precision": lambda: changed(of_format(np.float32)),
    "single precision of the optimum": lambda: changed(of_format(np.float32), "optimum"),
    "other seeds": lambda: Faulty(network(), other_seeds(network().propose_many, 12_345), "seeds"),
    "yet other seeds": lambda: Faulty(network(), other_seeds(network().propose_many, 99), "seeds"),
    "one more pass": lambda: Faulty(network(), one_more_pass(network().propose_many), "pass"),
    "spreads 5 % wider": lambda: changed(lambda positions, spreads: (positions, 1.05 * spreads)),
    "spreads 5 % narrower": lambda: changed(lambda positions, spreads: (positions, 0.95 * spreads)),
    "0.2 mm higher": lambda: changed(lambda positions, spreads: (positions + [0.0, 0.0, 2e-4], spreads)),
    "student": lambda: network("student"),
    **{
        f"{one} {base}": lambda one=one, base=base: avoider_named(f"{one}_on_{base}")
        for one in HARMLESS
        if one != "in_time"
        for base in ("network", "optimum")
    },
}


# Less of the same.
LESS = (
    *(
        f"{base} rounded to {step} mm"
        for base in ("network", "optimum")
        for step in ("0.001", "0.01", "0.1", "0.25")
    ),
    *("rounded to a 4096th", "single precision", "single precision of the optimum", "yet other seeds"),
)


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=[pytest.mark.long] * (one in LESS)) for one in CHANGES]
)
def test_a_harmless_change_is_neither_unsafe_nor_unlike(name: str, found: Found) -> None:
    assert [(one.kind, one.words) for one in found(CHANGES[name])] == []


@pytest.mark.parametrize("away_m", [0.1, 0.2])
def test_an_avoider_that_retreats_straight_from_the_hand_is_unlike_and_not_unsafe(
    away_m: float, found: Found
) -> None:
    kinds = {one.kind for one in found(lambda: OppositePose(away_m))}  # type: ignore[arg-type,return-value]
    assert not kinds & UNSAFE
    assert {Kind.FAR_OFF, Kind.WRONG_AND_SURE, Kind.HAND_PULL} <= kinds <= set(Kind)


@pytest.mark.parametrize(
    ("name", "kinds"),
    [
        ("sign_flip_2_on_network", {Kind.LEADS_TOWARDS, Kind.SURE_AND_UNSAFE}),
        ("two_modes_1_on_network", {Kind.JUMPS}),
        ("unseeded_1_on_optimum", {Kind.NOT_REPEATED}),
        ("rounded_batches_1_on_network", {Kind.NOT_REPEATED}),
        ("declared_late_1_on_optimum", {Kind.SLOW}),
        ("nan_near_a_hand_3_on_optimum", {Kind.NO_ANSWER}),
    ],
)
def test_a_fault_is_unsafe(name: str, kinds: set[Kind], found: Found) -> None:
    assert kinds <= {one.kind for one in found(lambda: avoider_named(name))} & UNSAFE


def test_a_fault_on_a_twentieth_of_the_seeds_is_named_although_yardsticks_lead_towards_as_often() -> None:
    few = scoring.Counts(first=1_000, segments=20, alone=20, sample=20)
    below = network("mc-dropout")

    def ask(hands: Array, tcps: Array, seeds: Array) -> Answers:
        positions, spreads = below.propose_many(hands, tcps, seeds)
        return np.where(
            (seeds % np.uint64(20) == 0)[:, None], tcps + 0.1 * (hands - tcps), positions
        ), spreads

    card = scoring.score(Subject.made_by(lambda: Faulty(below, ask, "x"), "x"), SEEN, seed=1, counts=few)
    yardsticks = scoring.yardsticks(SEEN, seed=1, counts=few)
    own, *theirs = (one.regions[0].leads_away for one in (card, *yardsticks))
    assert own is not None
    assert any(one is not None and own.share > one.low - 0.03 for one in theirs)
    said = [one for one in findings(card, yardsticks) if one.kind is Kind.LEADS_TOWARDS]
    assert [one.words.endswith("where each yardstick leads away") for one in said] == [True]


@pytest.mark.parametrize(
    ("name", "kind"),
    [("collapsed_2_on_optimum", Kind.SCALE), ("turned_base_1_on_network", Kind.FAR_OFF)],
)
def test_a_fault_of_likeness_is_named_and_is_not_unsafe(name: str, kind: Kind, found: Found) -> None:
    kinds = {one.kind for one in found(lambda: avoider_named(name))}
    assert kind in kinds - UNSAFE


def test_of_a_network_trained_here_a_spread_too_small_is_unsafe(found: Found) -> None:
    kinds = {one.kind for one in found(lambda: avoider_named("overconfident_1_on_network"))}
    assert Kind.SPREAD_MISSES in kinds & UNSAFE_OF_NETWORK
    assert Kind.SPREAD_MISSES not in UNSAFE


@pytest.mark.parametrize("kind", [np.float16, np.float64])
def test_a_clip_is_named_in_half_precision_too(kind: Any, found: Found) -> None:
    most = np.float64(np.float16(np.quantile(network_x(), 0.9)))

    def clipped(positions: Array, spreads: Array) -> tuple[Array, Array]:
        positions = positions.astype(kind).astype(float)
        return np.column_stack([np.minimum(positions[:, 0], most), positions[:, 1:]]), spreads

    assert Kind.STUCK in {one.kind for one in found(lambda: changed(clipped))}


def network_x() -> Array:
    """x of what the network answers in the seen region."""
    asked = SEEN[0].draw(np.random.default_rng(0), 500)
    return network().propose_many(asked.hands_in_base_m, asked.tcps_in_base_m, asked.seeds)[0][:, 0]


def test_the_step_of_a_number_format_is_that_of_its_largest_number() -> None:
    positions = np.random.default_rng(0).uniform(-0.9, 0.9, (2_000, 3))
    assert number_step_m(positions) == 0.0
    assert number_step_m(np.round(positions, 4)) == pytest.approx(1e-4)
    assert number_step_m(positions.astype(np.float16).astype(float)) == 2.0**-11
    assert number_step_m(positions.astype(np.float32).astype(float)) == 2.0**-24
    assert number_step_m(np.round(positions, 1)) == 0.0  # that is no number format


SEEING = """
import numpy as np
from safety_harness.cell.avoidance.avoider import Proposal

class Sees:
    name = "sees"
    sees = ("joints", "hands", "predicted hands")

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed, seen):
        at = lambda one: np.linalg.norm(one.position_in_base_m - seen.tcp_position_in_base_m)
        (hand, other), (predicted, _) = sorted(seen.hands, key=at), sorted(seen.predicted_hands, key=at)
        assert at(other) > 0.5
        assert np.abs(seen.tcp_position_in_base_m - tcp_position_in_base_m).max() < 1e-9
        assert np.abs(hand.position_in_base_m - hand_position_in_base_m).max() < 1e-9
        assert seen.joint_position_rad.shape == (6,) and np.isfinite(seen.joint_position_rad).all()
        way = seen.tcp_position_in_base_m - predicted.position_in_base_m
        return Proposal(tcp_position_in_base_m + 0.1 * way / max(np.linalg.norm(way), 1e-9))

class Towards(Sees):
    def propose(self, **question):
        tcp = question["tcp_position_in_base_m"]
        return Proposal(2.0 * tcp - super().propose(**question).position_in_base_m)

class Boxes(Sees):
    sees = ("hand boxes",)
"""


def test_an_avoider_that_sees_more_is_asked_with_what_it_sees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(SEEING)

    def exit_code(name: str) -> int:
        few: dict[str, Any] = {"questions": 20, "search": 20, "regions": ["seen"], "out": Path(name)}
        return evaluate([f"mine.py:{name}"], **few)

    assert exit_code("Sees") == AS_EXPECTED
    document = json.loads((Path("Sees") / DATA).read_text())
    (one,) = document["avoiders"]
    assert one["regions"][0]["answered"]["count"] == 20
    assert (one["findings"], document["finding_count"]) == ([], 0)
    assert one["unlike_the_reference"] != []
    assert "(findings only with --against)" in capsys.readouterr().out
    assert exit_code("Towards") == DIFFERS
    capsys.readouterr()
    assert exit_code("Boxes") == BAD_INPUT
    said = capsys.readouterr().err
    assert said.count("not applicable: it sees hand boxes") == 1
