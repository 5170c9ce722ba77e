"""A predictor of the user's: runs, its sets in the gate, the claim about them, traces, and misbehaviour."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from math import comb
from pathlib import Path

import numpy as np
import pytest

from safety_harness import load_trace
from safety_harness.admission.admit import admit
from safety_harness.admission.repeatability import Repeatability
from safety_harness.admission.trial import judge, run_kinematic, run_many
from safety_harness.base.exceptions import ControllerError, InadmissibleError, TraceError
from safety_harness.claims.properties.base import Evaluation
from safety_harness.extensions.assurance.statistics.binomial import violation_bounds
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.scenario.read import parse_scenario, read_scenario
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.consistency import first_inconsistency
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace
from tests.assurance.statistics.streams import violations
from tests.whole.test_own_controller import command

HELD = "predicted sets of at most 400 mm hold each hand that has been there for 200 ms, at a drawn instant"
PREDICTORS = """
import json
import sys

import numpy as np

from safety_harness import HandSet, Predicted


class Ball:
    name = "ball"
    sees = ("hands",)
    episodes = 0

    def reset(self, *, settings, arm, start, seed):
        self.ticks, Ball.episodes = 0, Ball.episodes + 1

    def act(self, seen):
        self.ticks += 1
        hands = (hand.position_in_base_m for hand in seen.hands)
        return Predicted(hands=tuple(self.set_of(k + 1, p) for k, p in enumerate(hands)))

    def set_of(self, number, position):
        return HandSet(position_in_base_m=position, number=number, radius_m=0.25)


class Box(Ball):
    def set_of(self, number, position):
        return HandSet(position_in_base_m=position, number=number, half_widths_m=np.array([0.1, 0.2, 0.3]))


class Ellipsoid(Ball):
    def set_of(self, number, position):
        shape = np.array([[0.04, 0.01, 0.0], [0.01, 0.04, 0.0], [0.0, 0.0, 0.01]])
        return HandSet(position_in_base_m=position, number=number, ellipsoid_m2=shape)


class Tiny(Ball):
    def set_of(self, number, position):
        return HandSet(position_in_base_m=position, number=number, radius_m=1e-6)


class Nobody(Ball):
    def act(self, seen):
        return Predicted()


class Remembers(Ball):
    def set_of(self, number, position):
        return HandSet(position_in_base_m=position + 0.1 * Ball.episodes, number=number, radius_m=0.25)


class Grows(Ball):
    def set_of(self, number, position):
        return HandSet(position_in_base_m=position, number=number, radius_m=0.1 * Ball.episodes)


class Millimetres(Ball):
    def set_of(self, number, position):
        return HandSet(position_in_base_m=position, number=number, radius_m=250.0)


class NotANumber(Ball):
    def set_of(self, number, position):
        return HandSet(position_in_base_m=position, number=number, radius_m=float("nan"))


class TwoSets(Ball):
    def set_of(self, number, position):
        box = np.full(3, 0.1)
        return HandSet(position_in_base_m=position, number=number, radius_m=0.1, half_widths_m=box)


class NoSet(Ball):
    def set_of(self, number, position):
        return HandSet(position_in_base_m=position, number=number)


class Flat(Ball):
    def set_of(self, number, position):
        return HandSet(position_in_base_m=position, number=number, ellipsoid_m2=np.diag([0.1, 0.1, 0.0]))


class Negative(Ball):
    def set_of(self, number, position):
        return HandSet(position_in_base_m=position, number=number, half_widths_m=np.array([0.1, -0.1, 0.1]))


class NumberZero(Ball):
    def set_of(self, number, position):
        return HandSet(position_in_base_m=position, number=0, radius_m=0.1)


class Twins(Ball):
    def act(self, seen):
        return Predicted(hands=(self.set_of(1, np.zeros(3)), self.set_of(1, np.ones(3))))


class Crowd(Ball):
    def act(self, seen):
        return Predicted(hands=tuple(self.set_of(k + 1, np.zeros(3)) for k in range(99)))


class Moves(Ball):
    def act(self, seen):
        from safety_harness import Move

        return Move()


class Raises(Ball):
    def act(self, seen):
        return 1 // 0


class Watches(Ball):
    sees = ("image",)


if __name__ == "__main__":  # the same as Ball, as a program
    for line in sys.stdin:
        said = json.loads(line)
        answer = {"say": "ready"}
        if said["say"] == "hello":
            answer = {"say": "hello", "protocol": said["protocol"], "name": "ball", "sees": ["hands"]}
        if said["say"] == "act":
            places = [hand["position_in_base_m"] for hand in said["seen"]["hands"]]
            answer = {"say": "prediction", "tick": said["tick"], "hands": []}
            for k, place in enumerate(places):
                answer["hands"].append({"position_in_base_m": place, "number": k + 1, "radius_m": 0.25})
        print(json.dumps(answer), flush=True)
"""
SCENARIO = f"""
scenario: a hand reaches for the tool
duration: 1.6 s
seed: 7
tcp start:
  offset: [40 mm, -120 mm, 60 mm]
avoider: opposite pose
predictor: kalman filter
gate: {{every hand in its set: yes}}
hands:
  - hand: right hand
    starts at: [1.2 m, -0.7 m, 100 mm]
    elbow towards: [1.6 m, -1.2 m, 300 mm]
    moves:
      - wait: 300 ms
      - reach for tcp: 1 m/s
        stop at distance: 40 mm
        give up after: 1 s
      - withdraw: 1 m/s
claims:
  no moving part touches a hand: holds
  {HELD}: holds
"""
KALMAN, RULE = "predictor: kalman filter\n", "gate: {every hand in its set: yes}\n"
SHORT = SCENARIO.replace("duration: 1.6 s", "duration: 0.4 s")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(PREDICTORS)
    return tmp_path


def scenario(reference: str = "", text: str = SCENARIO) -> Scenario:
    line = f'predictor: "{reference}"\n' if reference else ""
    Path("visit.yaml").write_text(text.replace(KALMAN, line or KALMAN))
    return read_scenario(Path("visit.yaml"))


def run_with(reference: str = "", text: str = SCENARIO) -> Trace:
    return run_kinematic(admit(scenario(reference, text)))


def held(trace: Trace) -> Evaluation:
    (evaluation,) = (item for item in judge(trace) if item.sentence == HELD)
    return evaluation


def in_a_folder(factory: pytest.TempPathFactory, reference: str) -> Trace:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(factory.mktemp("predicted"))
        Path("mine.py").write_text(PREDICTORS)
        return run_with(reference)


@pytest.fixture(scope="module")
def without() -> Trace:
    return run_kinematic(admit(parse_scenario(SCENARIO.replace(KALMAN + RULE, ""))))


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Trace:
    return in_a_folder(tmp_path_factory, "mine.py:Ball")


@pytest.fixture(scope="module")
def box(tmp_path_factory: pytest.TempPathFactory) -> Trace:
    return in_a_folder(tmp_path_factory, "mine.py:Box")


def assert_equal_ticks(one: Trace, other: Trace) -> None:
    for name in one.ticks.dtype.names or ():
        floats = one.ticks[name].dtype.kind == "f"
        assert np.array_equal(one.ticks[name], other.ticks[name], equal_nan=floats), name


def test_the_kalman_filter_as_a_predictor_changes_no_bit_of_a_run(without: Trace) -> None:
    predicted = run_kinematic(admit(parse_scenario(SCENARIO.replace(RULE, ""))))
    assert_equal_ticks(without, predicted)
    assert len(without.decisions)
    assert without.decisions["chosen_position_in_base_m"].tobytes() == (
        predicted.decisions["chosen_position_in_base_m"].tobytes()
    )
    assert len(without.predicted) == 0
    assert (predicted.predicted["box"] == predicted.ticks["track_valid"]).all()


def test_the_servo_gives_way_to_the_predicted_hands(ball: Trace) -> None:
    ticks, decision = ball.ticks, ball.decisions[0]
    seen = np.flatnonzero(ticks["track_valid"][:, 0])
    last = ticks["hand_position_in_base_m"][seen[-1], 0]
    assert np.linalg.norm(ticks["predicted_hand_in_base_m"][seen[-1], 0] - last) < 0.15
    tick = decision["asked_tick"]
    assert np.array_equal(decision["hand_position_in_base_m"], ticks["predicted_hand_in_base_m"][tick, 0])


def test_the_gate_takes_the_sets_as_half_widths(without: Trace) -> None:
    """A huge set makes the demanded distance of every hand unattainable, a tiny one leaves the proposal."""
    huge = PREDICTORS.replace("radius_m=0.25", "radius_m=2.0")
    Path("mine.py").write_text(huge)
    large = run_with("mine.py:Ball")
    small = run_with("mine.py:Tiny")
    assert (large.decisions["proposed_failed"] != small.decisions["proposed_failed"]).any()


@pytest.mark.parametrize("name", ["Ball", "Box", "Ellipsoid"])
def test_the_claim_agrees_with_a_gauge_by_hand(name: str) -> None:
    trace = run_with(f"mine.py:{name}")
    evaluation = held(trace)
    assert evaluation.worst_time_s is not None
    tick = round(evaluation.worst_time_s / 0.008)
    ahead = trace.scenario.settings.hand_filter.prediction_horizon_s / 0.008
    low = int(tick + ahead)
    part = tick + ahead - low
    hands = trace.ticks["hand_position_in_base_m"][:, 0]
    off = (1.0 - part) * hands[low] + part * hands[low + 1] - trace.ticks["predicted_hand_in_base_m"][tick, 0]
    shape = np.array([[0.04, 0.01, 0.0], [0.01, 0.04, 0.0], [0.0, 0.0, 0.01]])
    gauge = {
        "Ball": np.linalg.norm(off) / 0.25,
        "Box": np.abs(off / [0.1, 0.2, 0.3]).max(),
        "Ellipsoid": np.sqrt(off @ np.linalg.inv(shape) @ off),
    }[name]
    assert evaluation.margin == pytest.approx((1.0 - gauge) / (1.0 + gauge), abs=1e-9)
    assert (evaluation.verdict is Verdict.VIOLATED) == (gauge > 1.0)


def test_the_claim_catches_sets_that_are_too_small_and_hands_that_are_not_expected(without: Trace) -> None:
    assert held(run_with("mine.py:Tiny")).verdict is Verdict.VIOLATED
    nobody = held(run_with("mine.py:Nobody"))
    assert (nobody.verdict, nobody.margin) == (Verdict.VIOLATED, -1.0)
    assert "no set" in nobody.reason
    millimetres = held(run_with("mine.py:Millimetres"))
    assert (millimetres.verdict, millimetres.margin) == (Verdict.VIOLATED, -1.0)
    unjudged = held(without)
    assert (unjudged.verdict, unjudged.reason) == (Verdict.INCONCLUSIVE, "the scenario has no predictor")


def test_over_seeds_the_share_of_violated_runs_is_the_share_of_instants_that_miss(box: Trace) -> None:
    """So the exact bound over runs, each of one instant, covers the share in at least 95 % of campaigns."""
    sets, ticks = box.predicted.copy(), np.arange(len(box.ticks))
    sets["shape_m2"][ticks % 5 < 2] = 1e-12 * np.eye(3)  # two of five ticks miss
    trace = replace(box, predicted=sets)
    one = held(trace)
    count = one.exercised
    missed = [
        held(replace(trace, scenario=replace(trace.scenario, seed=seed))).verdict is Verdict.VIOLATED
        for seed in range(600)
    ]
    eligible = np.flatnonzero((box.time_s >= 0.2 - 1e-9) & (box.time_s <= box.time_s[-1] - 0.1 + 1e-9))
    assert count == len(eligible)
    share = np.mean(eligible % 5 < 2)
    assert abs(np.mean(missed) - share) < 4.0 * np.sqrt(share * (1.0 - share) / len(missed))
    runs = 20  # of a campaign, whose count of misses is binomial with this share
    chances = [comb(runs, k) * share**k * (1.0 - share) ** (runs - k) for k in range(runs + 1)]
    bounds = [violation_bounds(violations(k, runs), 0.95).high for k in range(runs + 1)]
    assert sum(chance for chance, high in zip(chances, bounds, strict=True) if high >= share) >= 0.95


def test_a_program_predicts_as_the_class_does(ball: Trace) -> None:
    by_program = run_with(f"exec:{sys.executable} mine.py")
    assert_equal_ticks(ball, by_program)
    assert np.array_equal(ball.predicted["shape_m2"], by_program.predicted["shape_m2"])
    assert by_program.system.predictor is not None
    assert by_program.system.predictor.sha256


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("NotANumber", "act predicted a radius_m that is not finite"),
        ("TwoSets", "not one of ball, box and ellipsoid: radius_m and half_widths_m"),
        ("NoSet", "not one of ball, box and ellipsoid: none"),
        ("Flat", "an ellipsoid_m2 that is not symmetric and positive definite"),
        ("Negative", "act predicted a half_widths_m that is not positive"),
        ("NumberZero", "a hand whose number is no integer from 1: 0"),
        ("Twins", "two hands with the same number"),
        ("Crowd", "act predicted 99 hands"),
        ("Moves", "act returned no Predicted"),
        ("Raises", "act raised: ZeroDivisionError"),
    ],
)
def test_misbehaviour_ends_the_run_and_names_the_predictor(name: str, words: str) -> None:
    with pytest.raises(ControllerError, match=re.escape("the predictor 'ball': ") + ".*" + re.escape(words)):
        run_with(f"mine.py:{name}")


@pytest.mark.parametrize(
    ("reference", "change", "words"),
    [
        ("mine.py:Absent", "", "something called 'Absent'"),
        ("nowhere.py:Ball", "", "no such file"),
        ("kalman", "", "a predictor: kalman filter, FILE.py:NAME"),
        ("mine.py", "", "name the class in it as well"),
        ("mine.py:Watches", "", "a predictor, which sees no image"),
        ("mine.py:Ball", "controller: stop when near\n", "does its own prediction"),
    ],
)
def test_what_cannot_be_a_predictor_is_refused_before_the_run(
    reference: str, change: str, words: str
) -> None:
    text = SCENARIO
    if change:
        text = text.replace(KALMAN + RULE, f'predictor: "{reference}"\n')
        text, reference = text.replace("avoider: opposite pose\n", change), ""
    with pytest.raises(InadmissibleError, match=re.escape(words)):
        admit(scenario(reference, text))


def test_a_controller_that_answers_with_predictions_ends_its_run() -> None:
    text = SCENARIO.replace("avoider: opposite pose\n", "controller: mine.py:Ball\n")
    text = text.replace(KALMAN + RULE, "")
    with pytest.raises(ControllerError, match="act returned no Move and no Stop"):
        run_with("", text)


def test_a_servo_that_does_not_ask_the_predictor_is_refused() -> None:
    admitted = admit(scenario("mine.py:Ball", SHORT))
    other = replace(admitted, predictor=None).servo()
    with pytest.raises(ControllerError, match="does not ask the predictor of its scenario"):
        run_kinematic(admitted, controller=other)


def test_many_runs_equal_single_runs(ball: Trace) -> None:
    several = [admit(scenario("mine.py:Ball")) for _ in range(2)]
    for trace in run_many(several):
        assert_equal_ticks(ball, trace)


@pytest.mark.parametrize("name", ["Remembers", "Grows"])
def test_a_memory_of_earlier_episodes_is_noticed(name: str) -> None:
    admitted = admit(scenario(f"mine.py:{name}"))
    repeatability = Repeatability()
    for _ in range(2):
        repeatability.add(run_kinematic(admitted))
    problem = repeatability.check().problem
    assert problem.startswith("the avoider or its predictor ")
    assert "act_many" not in problem


def test_of_many_predictors_each_is_repeated() -> None:
    repeatability = Repeatability()
    traces = [run_with(f"mine.py:{name}", SHORT) for name in ("Ball", "Box", "Tiny", "Nobody", "Ellipsoid")]
    for trace in [*traces, *traces]:
        repeatability.add(trace)
    result = repeatability.check()
    assert (result.asked >= 5, result.problem) == (True, "")
    assert "driven again by a fresh avoider and predictor: the same to the last bit" in result.line


def test_traces_keep_the_sets_and_refuse_lost_ones(ball: Trace, tmp_path: Path) -> None:
    save_trace(ball, tmp_path / "a.trace")
    again = load_trace(tmp_path / "a.trace")
    assert np.array_equal(again.predicted["shape_m2"], ball.predicted["shape_m2"])
    assert again.system.predictor == ball.system.predictor
    assert held(again) == held(ball)
    lost = ball.predicted.copy()
    lost["shape_m2"] = 0.0
    assert first_inconsistency(replace(ball, predicted=lost)) is not None
    forged = ball.predicted.copy()  # every hand would have the gauge 0 in it
    forged["shape_m2"][:] = [[0.01, 0.02, 0.0], [0.02, 0.01, 0.0], [0.0, 0.0, 0.01]]
    assert first_inconsistency(replace(ball, predicted=forged)) is not None
    save_trace(replace(ball, predicted=ball.predicted[:-1].copy()), tmp_path / "b.trace")
    with pytest.raises(TraceError, match="one a tick"):
        load_trace(tmp_path / "b.trace")


def test_a_scenario_without_a_predictor_is_written_as_before() -> None:
    assert "\npredictor:" not in write_scenario(
        parse_scenario(SCENARIO.replace(KALMAN + RULE, "")), all_settings=True
    )
    assert '\npredictor: "mine.py:Ball"\n' in write_scenario(scenario("mine.py:Ball"))


def test_run_replay_and_attribute_name_the_predictor() -> None:
    scenario("mine.py:Tiny", SHORT)
    found = command("run", "visit.yaml", "--world", "kinematic", "--out", "out")
    assert "predictor ball" in found.output
    assert "--predictor mine.py:Tiny" in found.output
    trace = "out/traces/visit.trace"
    assert "expected the program named with --predictor" in command("replay", trace).output
    assert command("replay", trace, "--predictor", "mine.py:Tiny").exit_code == 0
    assert command("replay", trace, "--predictor", "mine.py:Ball").exit_code == 2
    attributed = command("attribute", trace, "--predictor", "mine.py:Tiny")
    assert attributed.exit_code == 0
    other = command("attribute", trace, "--predictor", "mine.py:Ball")
    assert (other.exit_code, "as then" in other.output) == (2, True)
    Path("mine.py").write_text(PREDICTORS + "\n# edited\n")
    edited = command("replay", trace, "--predictor", "mine.py:Tiny")
    assert edited.exit_code == 2
    assert "as then" in edited.output


def test_attribution_puts_the_kalman_filter_in_the_predictors_place() -> None:
    scenario("mine.py:Tiny", SCENARIO.replace("reach for tcp: 1 m/s", "reach for tcp: 0.2 m/s"))
    command("run", "visit.yaml", "--world", "kinematic", "--out", "out")
    found = command("attribute", "out/traces/visit.trace", "--predictor", "mine.py:Tiny")
    assert found.exit_code == 0, found.output
    assert "predictor (the Kalman filter)" in found.output


def test_an_edited_predictor_stops_a_campaign_that_goes_on() -> None:
    text = SHORT.replace("scenario:", "scenario space:").replace(
        "wait: 300 ms", "wait: from 200 ms to 400 ms"
    )
    Path("space.yaml").write_text(text.replace("kalman filter", "mine.py:Ball"))
    Path("plan.yaml").write_text(
        "plan: predictors\nworld: kinematic\nseed: 1\nstrata:\n  - stratum: all\n    space: space.yaml\n"
        f"    runs: 4\nclaims:\n  - claim: {HELD}\n"
    )
    first = command("campaign", "run", "plan.yaml", "--ledger", "c.sqlite", "--workers", "1")
    assert first.exit_code in (0, 1), first.output
    assert "predictor mine.py:Ball" in first.output
    Path("mine.py").write_text(PREDICTORS.replace("0.25", "0.26"))
    second = command("campaign", "run", "plan.yaml", "--ledger", "c.sqlite", "--workers", "1")
    assert second.exit_code == 2
    assert "mine.py changed" in second.output
