"""A table of changes of one avoider: no harmless one is a difference, and every fault is one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

import safety_harness
from safety_harness.cell.avoidance.model_file import load_model, save_model
from safety_harness.cli.console import AS_EXPECTED, DIFFERS
from safety_harness.cli.fuzz import fuzz
from safety_harness.extensions.attribution.search_attribution import SearchAttribution
from safety_harness.report import search_job
from safety_harness.search import session as search_session
from safety_harness.search.counterexample import Explanation
from tests.search.short_space import TEXT

SPACE = TEXT.replace("400 ms", "700 ms").replace("0.2 m/s to 2 m/s", "0.45 m/s to 0.6 m/s")
FILE = """\
import numpy as np

from safety_harness import Proposal


class Base:
    name = "base"
    passes, wider, more = 4, 1.0, 0

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        hand, tcp = hand_position_in_base_m, tcp_position_in_base_m
        noise = np.random.default_rng(seed + self.more).normal(0.0, 0.1 * self.wider, (self.passes, 3))
        way = self.way((tcp - hand) / np.linalg.norm(tcp - hand), hand, tcp)
        return Proposal(self.given(tcp + 0.1 * way + noise.mean(axis=0)))

    def way(self, away, hand, tcp):
        return away

    def given(self, position):
        return position


def of(**changes):
    return type("Changed", (Base,), changes)


def rounded(step_m):
    return of(given=lambda self, position: np.round(position / step_m) * step_m)


def struck(share):
    def way(self, away, hand, tcp):
        bits = np.random.default_rng(np.frombuffer(hand.tobytes() + tcp.tobytes(), np.uint32)).random()
        return -away if bits < share else away

    return of(way=way)


def in_a_tenth_of_all_places(self, away, hand, tcp):
    cell = np.floor(hand * 10.0).astype(int) + 1000
    return -away if int(cell @ [73856093, 19349663, 83492791]) * 2654435761 % 2**32 < 0.1 * 2**32 else away


def aside(away):
    turned = np.cross(away, [0.0, 0.0, 1.0])
    return 0.995 * turned / np.linalg.norm(turned) + 0.1 * away


Rounded1um, Rounded10um, Rounded100um = rounded(1e-6), rounded(1e-5), rounded(1e-4)
Quarter, Half, Whole, Power = rounded(0.00025), rounded(0.0005), rounded(0.001), rounded(2.0**-12)
Half16 = of(given=lambda self, position: position.astype(np.float16).astype(float))
Single = of(given=lambda self, position: position.astype(np.float32).astype(float))
Down = of(given=lambda self, position: np.floor(position / 0.00025) * 0.00025)
Seed1, Seed2, Seed3, Seed4, Seed5 = of(more=1), of(more=20), of(more=300), of(more=4_000), of(more=50_000)
More, YetMore, Twice = of(passes=5), of(passes=6), of(passes=8)
Wider, Narrower = of(wider=1.02), of(wider=0.98)
Tick, Late = of(decision_time_s=0.008), of(decision_time_s=0.096)
Higher = of(given=lambda self, position: position + np.array([0.0, 0.0, 2e-4]))
Longer = of(way=lambda self, away, hand, tcp: 1.002 * away)

Beyond = of(way=lambda self, away, hand, tcp: aside(away) if hand[0] > 0.78 else away)
Towards = of(way=lambda self, away, hand, tcp: -away)
Stays = of(way=lambda self, away, hand, tcp: 0.0 * away)
OneInThree = struck(0.33)
OneInTen = of(way=in_a_tenth_of_all_places)
Silent = of(way=lambda self, away, hand, tcp: away * (np.nan if hand[0] > 0.78 else 1.0))
Under = of(way=lambda self, away, hand, tcp: np.array([0.0, 0.0, -9.0]) if hand[0] > 0.78 else away)


class Sure(Base):
    most_m, spread_threshold_m = 0.03, 0.025

    def propose(self, *, seed, **question):
        answer = super().propose(seed=seed, **question)
        spread_m = np.random.default_rng(seed).uniform(0.0, self.most_m)
        return Proposal(answer.position_in_base_m, np.full(3, spread_m))


Beside = of(given=lambda self, position: position + np.array([0.0, 0.04, 0.0]))
Doubts = type("Doubts", (Sure,), {"most_m": 0.05})
Within = of(way=lambda self, away, hand, tcp: aside(away) if hand[0] <= 0.78 else away)
"""
HARMLESS = ("Whole", "Seed1", "Tick")
# Less of the same, and others of the same kind.
LESS = (
    *("Rounded1um", "Rounded10um", "Rounded100um", "Quarter", "Half", "Power", "Single", "Half16", "Down"),
    *(
        "Seed2",
        "Seed3",
        "Seed4",
        "Seed5",
        "More",
        "YetMore",
        "Twice",
        "Narrower",
        "Wider",
        "Higher",
        "Longer",
    ),
)
CLAIMS = ("hand distance never below 100 mm", "proposals lead away to within 10 mm")
FAULTS = (
    *("Beyond", "OneInThree", "Silent"),
    *(
        pytest.param(name, marks=pytest.mark.long) for name in ("Stays", "Towards")
    ),  # everywhere: found at once
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 4)
    monkeypatch.setattr(search_session, "MOST_SHRUNK", 1)
    # Whether it answers alike when asked again is told apart from whether it differs.
    monkeypatch.setattr(search_session.SearchSession, "_ask_again", lambda session: None)
    # So are causes; and the page before they are known is another's matter.
    monkeypatch.setattr(SearchAttribution, "explain", lambda *_: Explanation())
    monkeypatch.setattr(search_job, "_write_interim", lambda session: None)
    (tmp_path / "space.yaml").write_text(SPACE)
    (tmp_path / "mine.py").write_text(FILE)
    return tmp_path


def searched(
    name: str, budget: int, against: str = "Base", seed: int = 0, claims: tuple[str, ...] = CLAIMS
) -> int:
    return fuzz(
        Path("space.yaml"),
        out=Path(name),
        avoider=f"mine.py:{name}",
        against=f"mine.py:{against}",
        claims=list(claims),
        budget=budget,
        seed=seed,
    )


@pytest.mark.parametrize("name", [*HARMLESS, *(pytest.param(name, marks=pytest.mark.long) for name in LESS)])
def test_a_harmless_change_is_no_difference(name: str, folder: Path) -> None:
    assert searched(name, 60) == AS_EXPECTED
    found = json.loads((folder / name / "findings.json").read_text())
    assert found["distinct"] == []
    assert found["counterexamples"] == []


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_a_difference(name: str, folder: Path) -> None:
    assert searched(name, 64) == DIFFERS
    assert json.loads((folder / name / "findings.json").read_text())["counterexamples"] != []


SEEDS = (0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2, 3)))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_fault_in_a_tenth_of_all_places_is_found_with_any_seed(seed: int, folder: Path) -> None:
    assert searched("OneInTen", 100, seed=seed) == DIFFERS


def test_a_fault_that_the_gate_overrules_is_a_difference_although_no_claim_is_violated(folder: Path) -> None:
    assert searched("Under", 40, claims=("joint positions within limits",)) == DIFFERS
    found = json.loads((folder / "Under" / "findings.json").read_text())
    assert found["counterexamples"] == []
    assert "300 runs anywhere in the space" in found["worse_than_the_reference"][0]
    page = (folder / "Under" / "fuzz.html").read_text()
    assert "refused a greater share of its proposals" in page
    assert "No violation found that" not in page


@pytest.mark.parametrize(
    ("name", "against", "found"),
    [
        ("Beside", "Base", "it answers over 20 mm farther off the optimum"),
        ("Late", "Base", "declares 96 ms for a decision"),
        ("Sure", "Doubts", "it has no spread above its threshold"),
    ],
)
def test_answers_of_which_no_claim_speaks_are_compared_with_the_references(
    name: str, against: str, found: str, folder: Path
) -> None:
    assert searched(name, 60, against, claims=("joint positions within limits",)) == DIFFERS
    (worse,) = json.loads((folder / name / "findings.json").read_text())["worse_than_the_reference"]
    assert worse.startswith(found)
    assert f"Worse than mine.py:{against}" in (folder / name / "fuzz.html").read_text()


def test_more_doubt_alone_is_no_difference(folder: Path) -> None:
    """The gate overrules it more often, and the fallback acts: the cautious side."""
    safe = ("joint positions within limits",)
    assert searched("Doubts", 40, against="Sure", claims=safe) == AS_EXPECTED
    assert "a greater share in" in (folder / "Doubts" / "fuzz.html").read_text()


@pytest.mark.parametrize("seed", SEEDS[:3])
def test_a_network_trained_from_another_seed_is_no_difference(seed: int, folder: Path) -> None:
    """It moves answers by up to 24 mm, so that each is significantly worse than the other in some places."""
    models = Path(safety_harness.__file__).parent / "models"
    one, several = (load_model(models / f"{name}.safetensors") for name in ("student", "student-ensemble"))
    own = {f"0/{name[2:]}": each for name, each in several.tensors.items() if name[0] == "1"}
    other = replace(several, tensors=own, members=1, passes=one.passes, calibration=one.calibration)
    save_model(other, Path("retrained.safetensors"))
    against = {"avoider": "retrained.safetensors", "against": "student"}
    out, claims = Path("out"), list(CLAIMS)
    assert fuzz(Path("space.yaml"), out=out, **against, claims=claims, budget=100, seed=seed) == AS_EXPECTED
    assert json.loads((out / "findings.json").read_text())["distinct"] == []


@pytest.mark.parametrize(
    ("name", "other"),
    [("Beyond", "Within"), pytest.param("Within", "Beyond", marks=pytest.mark.long)],
)
def test_two_that_are_each_a_little_worse_than_the_other_somewhere_differ_in_nothing_that_counts(
    name: str, other: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each alone comes too near in 45 of 300 pairs anywhere, never by more than 100 mm."""
    assert searched(name, 60, other, claims=CLAIMS[:1]) == AS_EXPECTED
    found = json.loads((folder / name / "findings.json").read_text())
    assert found["distinct"] == []
    assert any("pairs anywhere in the space" in one for one in found["flips_near_the_limit"])
    assert "runs anywhere in the space with both" in capsys.readouterr().err


def test_one_that_is_much_worse_somewhere_differs_though_it_is_better_elsewhere(folder: Path) -> None:
    """Where it goes aside it leads by more than 100 mm less away from the hand, in every pair drawn again."""
    assert searched("Within", 60, "Beyond", claims=CLAIMS[1:]) == DIFFERS
