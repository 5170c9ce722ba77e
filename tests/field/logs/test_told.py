"""What a controller told is judged by the claims about it: a planted fault is found, a repaired one held."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cells import Streams, Words, cell, recorded, words_of
from log_formats import csv

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import judge, run_kinematic
from safety_harness.base.exceptions import InputError, LogError
from safety_harness.claims.properties.base import Evaluation
from safety_harness.extensions.field.logs.certain import trace_from_log
from safety_harness.extensions.field.logs.read import read_log
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.read import read_scenario
from safety_harness.trace.records import DecisionOutcome, Mode, Trigger
from safety_harness.trace.store import load_trace, save_trace
from safety_harness.trace.trace import Trace

SCENARIOS = Path(__file__).parents[3] / "scenarios"
PREDICTED, TRUE = (f"starts retreating within 100 ms of a {hand} hand" for hand in ("predicted", "true"))
AWAY = "repulsion moves away from every hand to within 5 mm"
ALARM, FORESEEN = "never retreats without a hand", "hand predictions within 60 mm"
SEPARATION = "protective separation kept from hands at their own speeds"


OUTCOMES = {DecisionOutcome.PROPOSED: "OK", DecisionOutcome.OPPOSITE: "OTHER", DecisionOutcome.STOP: "HALT"}


def log_file(streams: Streams, folder: Path, *edits: tuple[str, str]) -> Path:
    """Beside CSV files, with parts of its text replaced."""
    text = csv(streams, folder)
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    (folder / "LOG.yaml").write_text(text)
    return folder / "LOG.yaml"


def judged(file: Path) -> dict[str, Evaluation]:
    """By their sentences."""
    return {one.sentence: one for one in judge(trace_from_log(read_log(file)).trace)}


def verdicts(file: Path) -> dict[str, Verdict]:
    """Of each claim."""
    return {sentence: one.verdict for sentence, one in judged(file).items()}


@pytest.fixture(scope="module")
def synthetic() -> tuple[Streams, Words, Words]:
    """A cell with a controller that does well, and with one that answers late by wrong predictions."""
    rng = np.random.default_rng(0)
    one = cell(rng)
    streams = recorded(one, rng, seconds=1.6)
    return streams, words_of(one, streams), words_of(one, streams, late_s=0.24, off_m=0.12)


@pytest.fixture(scope="module")
def run() -> Trace:
    """A simulated run in which the arm gives way to a hand, of which everything is known."""
    scenario = read_scenario(SCENARIOS / "hand-visits-and-leaves.yaml")
    return run_kinematic(admit(replace(scenario, duration_s=3.6)))


def logged(run: Trace) -> Streams:
    """The same as recorders would have it, without noise."""
    ticks, chosen = run.ticks, run.decisions
    time_ns = 1_700_000_000_000_000_000 + np.round(run.time_s * 1e9).astype(np.int64)
    names = {Mode.SERVOING: "RUN", Mode.REPULSING: "RETREAT"}
    predicted = np.where(ticks["track_valid"][:, :1], ticks["predicted_hand_in_base_m"][:, 0], np.nan)
    words = Words(
        mode=[names[Mode(mode)] for mode in ticks["mode"].tolist()],
        limits=[0] * len(ticks),
        commands_radps=ticks["demanded_joint_velocity_radps"],
        predicted_m=predicted,
        decided_ns=time_ns[chosen["tick"]],
        places_m={
            name: chosen[f"{name}_position_in_base_m"] for name in ("hand", "tcp", "proposed", "chosen")
        },
        outcome=[OUTCOMES[DecisionOutcome(one)] for one in chosen["outcome"].tolist()],
        trigger=[Trigger(one).name.lower().replace("_", " ") for one in chosen["trigger"].tolist()],
    )
    hand, elbow = ticks["hand_position_in_base_m"][:, 0], ticks["elbow_position_in_base_m"][:, 0]
    return Streams(time_ns, ticks["joint_position_rad"], time_ns + 137_000_000, hand, elbow, words)


CLOSELY = (
    ("known to: 8 mm", "known to: 1 mm"),
    ("137 ms, known to: 5 ms", "137 ms, known to: 0 ms"),
    ("known to: 0.2 mrad", "known to: 0.001 mrad"),
    ("accelerate at most: 4.0 rad/s2", "accelerate at most: 1.3 rad/s2"),
)


def test_a_controller_that_answers_late_by_wrong_predictions_is_found(
    synthetic: tuple[Streams, Words, Words], tmp_path: Path
) -> None:
    streams, well, badly = synthetic
    good = verdicts(log_file(replace(streams, words=well), tmp_path))
    bad = verdicts(log_file(replace(streams, words=badly), tmp_path))
    for sentence in (PREDICTED, FORESEEN):
        assert (good[sentence], bad[sentence]) == (Verdict.HOLDS, Verdict.VIOLATED)
    assert good[TRUE] is Verdict.HOLDS
    assert good["always hand tracked"] is Verdict.HOLDS
    assert good["proposals lead away to within 10 mm"] is Verdict.HOLDS


def test_a_run_that_is_logged_is_judged_as_the_run_is(run: Trace, tmp_path: Path) -> None:
    found = verdicts(log_file(logged(run), tmp_path, *CLOSELY))
    for sentence in (PREDICTED, TRUE, AWAY, ALARM, FORESEEN, "proposals lead away to within 10 mm"):
        assert found[sentence] is Verdict.HOLDS, sentence


def test_a_way_towards_the_hand_is_found(run: Trace, tmp_path: Path) -> None:
    streams = logged(run)
    assert streams.words is not None
    places = dict(streams.words.places_m)
    places["chosen"] = 2.0 * places["tcp"] - places["chosen"]
    wrong = replace(streams, words=replace(streams.words, places_m=places))
    assert verdicts(log_file(wrong, tmp_path, *CLOSELY))[AWAY] is Verdict.VIOLATED


def test_an_arm_that_says_that_it_retreats_and_stands_is_found(run: Trace, tmp_path: Path) -> None:
    streams, first = logged(run), int(run.decisions["tick"][0])
    joints = streams.joints_rad.copy()
    joints[first:] = joints[first]
    found = judged(log_file(replace(streams, joints_rad=joints), tmp_path, *CLOSELY))
    assert found[AWAY].verdict is Verdict.VIOLATED
    assert "executed way" in found[AWAY].reason


def test_giving_way_to_nobody_is_found(run: Trace, tmp_path: Path) -> None:
    streams = logged(run)
    assert streams.words is not None
    mode = list(streams.words.mode)
    mode[5:20] = ["RETREAT"] * 15
    wrong = replace(streams, words=replace(streams.words, mode=mode))
    assert verdicts(log_file(wrong, tmp_path, *CLOSELY))[ALARM] is Verdict.VIOLATED


def test_without_them_their_claims_say_that_they_were_not_recorded(
    synthetic: tuple[Streams, Words, Words], tmp_path: Path
) -> None:
    streams, well, _ = synthetic
    text = csv(replace(streams, words=well), tmp_path)
    lines = [line for line in text.splitlines() if not line.startswith(("mode:", "detections:"))]
    kept = "\n".join(lines).replace(', mode: "words.csv#state"', "")
    kept = kept.replace(', detections: "words.csv#right"', "")
    (tmp_path / "LOG.yaml").write_text(kept)
    found = judged(tmp_path / "LOG.yaml")
    for sentence, column in ((PREDICTED, "mode"), (ALARM, "mode"), (FORESEEN, "track_valid")):
        assert found[sentence].verdict is Verdict.INCONCLUSIVE
        assert found[sentence].reason.startswith("not measured:")
        assert column in found[sentence].unmeasured


def test_a_stamp_that_is_not_known_well_leaves_open_when_the_mode_changed(run: Trace, tmp_path: Path) -> None:
    unsure = ("repulsing}, known to: 0 ms", "repulsing}, known to: 60 ms")
    log = log_file(logged(run), tmp_path, *CLOSELY, unsure)
    trace = trace_from_log(read_log(log)).trace
    gaps = trace.known.column("mode").gaps
    changes = np.flatnonzero(np.diff(run.ticks["mode"])) + 1
    assert gaps[0].first == 0  # nothing was told before the first of them
    assert all(gap.first < change < gap.after for gap, change in zip(gaps[1:], changes, strict=True))
    found = judged(log)
    assert found[PREDICTED].verdict is Verdict.HOLDS
    late = replace(logged(run).words, mode=["RUN"] * len(run.ticks))  # type: ignore[type-var]
    assert (
        judged(log_file(replace(logged(run), words=late), tmp_path, *CLOSELY, unsure))[PREDICTED].verdict
        is Verdict.VIOLATED
    )


def test_where_no_stop_was_told_a_hand_too_near_is_not_excused_by_one(run: Trace, tmp_path: Path) -> None:
    streams = logged(run)
    assert streams.words is not None
    sentence = "protective separation kept at 0.6 m/s"
    slower = (SEPARATION, sentence)
    log = log_file(streams, tmp_path, *CLOSELY, slower)
    assert verdicts(log)[sentence] is Verdict.VIOLATED
    text = log.read_text().replace(', limits: "words.csv#flags"', "")
    log.write_text("\n".join(line for line in text.splitlines() if not line.startswith("limits:")))
    assert verdicts(log)[sentence] is Verdict.INCONCLUSIVE
    stops = replace(streams, words=replace(streams.words, limits=[2] * len(run.ticks)))
    assert verdicts(log_file(stops, tmp_path, *CLOSELY, slower))[sentence] is Verdict.INCONCLUSIVE


def test_a_mode_that_is_always_servoing_contradicts_a_retreat(run: Trace, tmp_path: Path) -> None:
    """Claims that read the mode would take the arm to have stayed at its task."""
    streams = logged(run)
    assert streams.words is not None
    claim = (FORESEEN, "converged to the desired pose")
    assert verdicts(log_file(streams, tmp_path, *CLOSELY, claim))
    told = ["RUN"] * len(streams.words.mode)
    streams = replace(streams, words=replace(streams.words, mode=told))
    with pytest.raises(LogError, match="as the mode is servoing all the while") as refused:
        judged(log_file(streams, tmp_path, *CLOSELY, claim))
    assert refused.value.place.file == tmp_path / "words.csv"
    assert "by the joints, away from a hand" in refused.value.got


def test_where_the_arm_ends_is_judged_by_its_motion_whatever_mode_a_log_tells(
    run: Trace, tmp_path: Path
) -> None:
    """A mode that is always a retreat changes nothing of a claim on motion."""
    streams = logged(run)
    assert streams.words is not None
    wrong = replace(streams, words=replace(streams.words, mode=["RETREAT"] * len(streams.words.mode)))
    for claim in ("converged to the desired pose", "keeps its place within 50 mm"):
        edits = (*CLOSELY, (FORESEEN, claim))
        right, found = (judged(log_file(one, tmp_path, *edits))[claim] for one in (streams, wrong))
        assert found == right
        assert "not measured" not in found.reason


def test_its_trace_is_stored_with_what_was_told(
    synthetic: tuple[Streams, Words, Words], tmp_path: Path
) -> None:
    streams, well, _ = synthetic
    found = trace_from_log(read_log(log_file(replace(streams, words=well), tmp_path)))
    save_trace(found.trace, tmp_path / "log.trace", recordings=found.recordings)
    again = load_trace(tmp_path / "log.trace")
    assert again.known == found.trace.known
    assert [one.verdict for one in judge(again)] == [one.verdict for one in judge(found.trace)]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("RETREAT: repulsing", "RETRAET: repulsing", "words.csv:43: state: expected one of RUN, RETRAET"),
        ("RETREAT: repulsing", "RETREAT: repelling", "mode.words.RETREAT: expected servoing"),
        ("words.csv#state", "words.csv#stat", "expected the name of a column; got stat"),
        ("words.csv#to_", "words.csv#told_", "words.csv:1: expected a column told_shoulder_pan_joint_radps"),
        ("chosen: chosen", "chosen: target", "decisions.csv:1: expected a column target_x_m"),
        ("known to: 0 ms, longest gap: 40 ms}\nlimits", "longest gap: 40 ms}\nlimits", 'the key "known to"'),
        ("ahead by: 100 ms, ", "", 'the key "ahead by"'),
        ("  frame: base\n  fields", "  fields", 'the key "frame"'),
        ("OTHER: opposite", "OTHER: nothing", "decisions.words.outcome.OTHER"),
        (
            "robot: UR10\n",
            "robot: UR10\nsettings: {hand filter: {prediction horizon: 50 ms}}\n",
            "expected 0.1 s",
        ),
        (', mode: "words.csv#state"', "", "expected a stream of mode below log"),
    ],
)
def test_a_mapping_that_is_wrong_is_refused_with_its_place(
    synthetic: tuple[Streams, Words, Words], tmp_path: Path, old: str, new: str, says: str
) -> None:
    streams, well, _ = synthetic
    with pytest.raises(InputError) as refused:
        trace_from_log(read_log(log_file(replace(streams, words=well), tmp_path, (old, new))))
    assert says in str(refused.value)


def test_numbers_that_cannot_be_are_refused_with_their_line(
    synthetic: tuple[Streams, Words, Words], tmp_path: Path
) -> None:
    streams, well, _ = synthetic
    nan, half = well.commands_radps.copy(), well.predicted_m.copy()
    nan[7, 2], half[9, 1] = np.nan, np.nan
    nowhere = dict(well.places_m) | {"chosen": well.places_m["chosen"] * np.nan}
    far = dict(well.places_m) | {"proposed": well.places_m["proposed"] * 1000.0}
    for words, says in (
        (replace(well, commands_radps=nan), "words.csv:9"),
        (replace(well, commands_radps=np.degrees(well.commands_radps) * 9.0), 'the key "unit"'),
        (replace(well, predicted_m=half), "words.csv:11"),
        (replace(well, places_m=nowhere), 'decisions.csv:2: expected decisions: three numbers for "chosen"'),
        (replace(well, places_m=far), 'the key "unit"'),
    ):
        with pytest.raises(LogError) as refused:
            read_log(log_file(replace(streams, words=words), tmp_path))
        assert says in str(refused.value)


OTHERS = ("always not stopped", "always not object lost", "always servoing")
EITHER = (
    "always (servoing or repulsing)",
    "always not (servoing and repulsing)",
)


@pytest.mark.parametrize("halts", [False, True])
def test_formulas_on_modes_are_judged_where_a_mode_was_one_of_two(
    synthetic: tuple[Streams, Words, Words], halts: bool, tmp_path: Path
) -> None:
    """Stamps that are off by 2 ms leave open which of two there was where it changed, but no third one."""
    streams, good, _ = synthetic
    change = next(k for k in range(1, len(good.mode)) if good.mode[k] != good.mode[k - 1])
    mode = ["HALT" if halts and k == change else one for k, one in enumerate(good.mode)]
    file = log_file(
        replace(streams, words=replace(good, mode=mode)),
        tmp_path,
        (
            "RUN: servoing, RETREAT: repulsing}, known to: 0 ms",
            "RUN: servoing, RETREAT: repulsing, HALT: stopped}, known to: 2 ms",
        ),
        ("log: {", "log: {from: 10 ms, "),
        ("claims:\n", "claims:\n" + "".join(f"  - {one}\n" for one in (*EITHER, *OTHERS))),
    )
    logged = trace_from_log(read_log(file))
    trace = logged.trace
    assert any(len(gap.either) > 1 for gap in trace.known.column("mode").gaps)
    save_trace(trace, tmp_path / "a.trace", recordings=logged.recordings)
    assert load_trace(tmp_path / "a.trace").known.column("mode") == trace.known.column("mode")
    found = {one.sentence: one.verdict for one in judge(trace)}
    if halts:
        assert found["always not stopped"] is not Verdict.HOLDS
        assert found[EITHER[0]] is not Verdict.HOLDS
    else:
        assert found["always not stopped"] is found[EITHER[0]] is Verdict.HOLDS
    assert found[EITHER[1]] is Verdict.HOLDS
    assert found["always not object lost"] is Verdict.HOLDS
    assert found["always servoing"] is Verdict.VIOLATED


def test_a_word_that_comes_and_goes_between_two_ticks_is_not_passed_over(
    synthetic: tuple[Streams, Words, Words], tmp_path: Path
) -> None:
    streams, good, _ = synthetic
    since_ns = streams.joint_ns - streams.joint_ns[0]
    between = int(np.flatnonzero((since_ns % 40_000_000 > 10_000_000) & (since_ns > 500_000_000))[0])
    for halts in (False, True):
        mode = ["HALT" if halts and k == between else "RUN" for k in range(len(good.mode))]
        file = log_file(
            replace(streams, words=replace(good, mode=mode)),
            tmp_path,
            ("RUN: servoing, RETREAT: repulsing}", "RUN: servoing, RETREAT: repulsing, HALT: stopped}"),
            ("log: {", "log: {period: 40 ms, "),
            ("claims:\n", "claims:\n  - always not stopped\n"),
        )
        found = judged(file)["always not stopped"].verdict
        assert found is (Verdict.INCONCLUSIVE if halts else Verdict.HOLDS)
