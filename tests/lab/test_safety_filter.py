"""A user's safety filter between controller and drives: runs, claims, traces, commands, and misbehaviour."""

from __future__ import annotations

import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness import load_trace
from safety_harness.admission.admit import admit
from safety_harness.admission.comparison import UNFILTERED, with_reference
from safety_harness.admission.repeatability import Repeatability
from safety_harness.admission.taking import accept
from safety_harness.admission.trial import judge, run_kinematic
from safety_harness.base.exceptions import ControllerError, InadmissibleError, Place, TraceError
from safety_harness.claims.properties.base import Evaluation
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.scenario.read import parse_scenario, read_scenario
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.consistency import first_inconsistency
from safety_harness.trace.records import Limit
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace
from tests.whole.test_own_controller import command

ROOT = Path(__file__).parents[2]
FLAG = int(Limit.SAFETY_FILTER)
NEEDLESS = "the safety filter changes no command that is harmless to hands of 2 m/s, braking at 1 m/s2"
FILTERS = """
import json
import sys

import numpy as np

from safety_harness import Move, Stop


class Passes:
    name = "passes"
    sees = ("wanted command",)

    def reset(self, *, settings, arm, start, seed):
        self.ticks = 0

    def act(self, seen):
        self.ticks += 1
        return self.changed(seen.wanted_command, seen)

    def changed(self, wanted, seen):
        return wanted.action


class Halves(Passes):
    def changed(self, wanted, seen):
        return wanted.action if wanted.stop else Move(joint_velocity_radps=0.5 * wanted.joint_velocity_radps)


class StopsOnce(Passes):
    def changed(self, wanted, seen):
        return Stop() if self.ticks == 20 else wanted.action


class NotANumber(Passes):
    def changed(self, wanted, seen):
        return Move(joint_velocity_radps=np.full(6, np.nan)) if self.ticks == 3 else wanted.action


class Raises(Passes):
    def changed(self, wanted, seen):
        return 1 // 0


class Remembers(Passes):
    episodes = 0

    def reset(self, **start):
        super().reset(**start)
        Remembers.episodes += 1

    def changed(self, wanted, seen):
        rates = wanted.joint_velocity_radps / Remembers.episodes
        return wanted.action if wanted.stop else Move(joint_velocity_radps=rates)


class OverridesStops(Passes):
    def changed(self, wanted, seen):
        return Move(joint_velocity_radps=np.full(6, 0.01)) if wanted.stop else wanted.action


class StopsBeforeAStop(Passes):
    sees = ("joints", "hands", "wanted command")

    def changed(self, wanted, seen):
        near = min(np.linalg.norm(h.position_in_base_m - seen.tcp_position_in_base_m) for h in seen.hands)
        return Stop() if 0.45 < near < 0.5 and not wanted.stop else wanted.action


class Blind(Passes):
    sees = ("joints",)


class Upwards:
    name = "upwards"
    sees = ("wanted command",)

    def reset(self, *, settings, arm, start, seed):
        pass

    def act(self, seen):
        return Move(tcp_velocity_mps=[0.0, 0.0, 0.05])


if __name__ == "__main__":  # the same as Halves, as a program
    for line in sys.stdin:
        said = json.loads(line)
        answer = {"say": "ready"}
        if said["say"] == "hello":
            answer = {"say": "hello", "protocol": said["protocol"], "name": "halves"}
            answer["sees"] = ["wanted command"]
        if said["say"] == "act":
            wanted = said["seen"]["wanted_command"]
            rates = [0.5 * rate for rate in wanted["joint_velocity_radps"]]
            answer = {"say": "move", "tick": said["tick"], "joint_velocity_radps": rates}
            if wanted["stop"]:
                answer = {"say": "stop", "tick": said["tick"]}
        print(json.dumps(answer), flush=True)
"""
SCENARIO = f"""
scenario: a hand reaches for the tool
duration: 1.6 s
seed: 7
tcp start:
  offset: [40 mm, -120 mm, 60 mm]
avoider: opposite pose
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
  {NEEDLESS}: holds
"""
SHORT = SCENARIO.replace("duration: 1.6 s", "duration: 0.4 s")  # the hand is still far away


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "filters.py").write_text(FILTERS)
    return tmp_path


def scenario(reference: str = "", text: str = SCENARIO) -> Scenario:
    line = f'safety filter: "{reference}"\n' if reference else ""
    Path("visit.yaml").write_text(text.replace("avoider:", f"{line}avoider:"))
    return read_scenario(Path("visit.yaml"))


def run_with(reference: str = "", text: str = SCENARIO) -> Trace:
    return run_kinematic(admit(scenario(reference, text)))


def needless(trace: Trace) -> Evaluation:
    (evaluation,) = (item for item in judge(trace) if item.sentence == NEEDLESS)
    return evaluation


@pytest.fixture(scope="module")
def without() -> Trace:
    return run_kinematic(admit(parse_scenario(SCENARIO)))


def in_a_folder(factory: pytest.TempPathFactory, reference: str, text: str = SCENARIO) -> Trace:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(factory.mktemp("filtered"))
        Path("filters.py").write_text(FILTERS)
        return run_with(reference, text)


@pytest.fixture(scope="module")
def halves(tmp_path_factory: pytest.TempPathFactory) -> Trace:
    return in_a_folder(tmp_path_factory, "filters.py:Halves")


@pytest.fixture(scope="module")
def passes(tmp_path_factory: pytest.TempPathFactory) -> Trace:
    return in_a_folder(tmp_path_factory, "filters.py:Passes")


@pytest.fixture(scope="module")
def stops_once(tmp_path_factory: pytest.TempPathFactory) -> Trace:
    """At tick 19, long before the hand comes."""
    quiet = SCENARIO.replace("wait: 300 ms", "wait: 1.5 s").replace("duration: 1.6 s", "duration: 3 s")
    return in_a_folder(tmp_path_factory, "filters.py:StopsOnce", quiet)


@pytest.mark.parametrize("driven", [False, True])
def test_a_filter_that_returns_the_command_changes_no_bit(
    driven: bool, without: Trace, passes: Trace
) -> None:
    filtered, plain = passes, without
    if driven:
        filtered, plain = driven_by_stop_when_near("filters.py:Passes"), driven_by_stop_when_near("")
    for name in plain.ticks.dtype.names or ():
        floats = plain.ticks[name].dtype.kind == "f"
        assert np.array_equal(plain.ticks[name], filtered.ticks[name], equal_nan=floats), name
    assert (filtered.ticks["limits"] & FLAG == 0).all()
    assert filtered.known.missing(["mode"]) == plain.known.missing(["mode"])


def test_the_trace_has_the_wanted_and_the_sent_command_and_a_flag_where_they_differ(
    without: Trace, halves: Trace
) -> None:
    trace = halves
    wanted, sent = trace.filtered["wanted_radps"], trace.ticks["demanded_joint_velocity_radps"]
    moves = ~trace.filtered["wanted_stop"]
    assert moves.any()
    assert np.array_equal(sent[moves], 0.5 * wanted[moves])
    flagged = trace.ticks["limits"] & FLAG != 0
    assert np.array_equal(flagged, moves & (wanted != 0.0).any(axis=1))
    assert np.array_equal(wanted[0], without.ticks["demanded_joint_velocity_radps"][0])
    assert np.abs(wanted).max() <= np.abs(without.ticks["demanded_joint_velocity_radps"]).max() + 1e-12


def test_after_a_stop_of_the_filter_the_arm_stands_until_the_restart_delay_is_over(stops_once: Trace) -> None:
    trace = stops_once
    held = np.flatnonzero(trace.filtered["held"])  # the filter stops at tick 19, and lets all else pass
    assert held[0] == 20
    released = held[-1]  # the first tick at which the command passes again, by the filter's own record of it
    speed = np.abs(trace.ticks["joint_velocity_radps"]).max(axis=1)
    delay_s = trace.scenario.settings.avoidance.restart_delay_s
    assert trace.time_s[released] - trace.time_s[19] >= delay_s - 1e-9
    assert speed[released] < 1e-3
    assert (trace.ticks["limits"][19:released] & FLAG != 0).all()
    assert speed[released + 1 :].max() > 1e-3


def driven_by_stop_when_near(reference: str) -> Trace:
    text = SCENARIO.replace("avoider: opposite pose", "controller: stop when near")
    line = f"safety filter: {reference}\n" if reference else ""
    return run_with("", text.replace("tcp start:", f"{line}tcp start:"))


def test_a_filter_that_overrides_a_protective_stop_violates_the_claim() -> None:
    trace = driven_by_stop_when_near("filters.py:OverridesStops")
    evaluation = needless(trace)
    assert trace.filtered["wanted_stop"].any()
    assert evaluation.verdict is Verdict.VIOLATED
    assert "in spite of" in evaluation.reason


def test_commands_are_compared_by_their_fields_and_a_stop_that_lasts_is_not_needless() -> None:
    trace = driven_by_stop_when_near("filters.py:StopsBeforeAStop")
    wanted, sent = trace.filtered["wanted_radps"], trace.ticks["demanded_joint_velocity_radps"]
    flagged = trace.ticks["limits"] & FLAG != 0
    assert flagged.any()
    stops = trace.filtered["wanted_stop"]
    assert not flagged[stops].any()  # the filter let each stop of the controller pass
    assert np.array_equal(wanted[~flagged], sent[~flagged])
    held = trace.filtered["held"]
    assert not held[stops].any()


def test_after_a_stop_of_the_filter_the_acceleration_is_bounded(stops_once: Trace) -> None:
    trace = stops_once
    pose = trace.ticks["transform_tcp_to_base"][:, :3, 3]
    speed_mps = np.linalg.norm(np.diff(pose, axis=0), axis=1) / 0.008
    begins = np.flatnonzero((speed_mps[1:] > 1e-3) & (speed_mps[:-1] < 1e-4) & (trace.time_s[1:-1] > 0.3))
    assert len(begins)
    most = trace.scenario.settings.motion.max_tcp_acceleration_mps2
    assert (np.diff(speed_mps)[begins[0] - 1 : begins[0] + 20] / 0.008).max() <= 1.05 * most


def test_a_filter_may_command_the_tcp() -> None:
    trace = run_with("filters.py:Upwards")
    height_m = np.diff(trace.ticks["transform_tcp_to_base"][:, 2, 3]) / 0.008
    assert height_m[50:].mean() == pytest.approx(0.05, abs=1e-3)


def test_a_program_filters_as_the_class_does(halves: Trace) -> None:
    by_class = halves
    by_program = run_with(f"exec:{sys.executable} filters.py")
    assert np.array_equal(
        by_class.ticks["demanded_joint_velocity_radps"], by_program.ticks["demanded_joint_velocity_radps"]
    )
    assert by_program.system.safety_filter is not None
    assert by_program.system.safety_filter.sha256


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("NotANumber", "the safety filter 'passes': act returned velocities that are not finite"),
        ("Raises", "the safety filter 'passes': act raised: ZeroDivisionError"),
    ],
)
def test_misbehaviour_ends_the_run_and_names_the_filter(name: str, words: str) -> None:
    with pytest.raises(ControllerError, match=re.escape(words)):
        run_with(f"filters.py:{name}")


@pytest.mark.parametrize(
    ("reference", "change", "words"),
    [
        ("filters.py:Blind", "", 'a safety filter with "wanted command" in its sees'),
        ("filters.py:Nobody", "", "something called 'Nobody'"),
        ("nowhere.py:Passes", "", "no such file"),
        ("stop when near", "", "a safety filter: FILE.py:NAME"),
        ("filters.py:Passes", "shield: speed and separation\n", "a shield or a safety filter"),
    ],
)
def test_what_cannot_be_a_filter_is_refused_before_the_run(reference: str, change: str, words: str) -> None:
    with pytest.raises(InadmissibleError, match=re.escape(words)):
        admit(scenario(reference, SCENARIO.replace("avoider:", f"{change}avoider:")))


def test_a_controller_does_not_see_the_wanted_command() -> None:
    text = SCENARIO.replace("avoider: opposite pose", "controller: filters.py:Passes")
    with pytest.raises(InadmissibleError, match="a controller, which sees no wanted command"):
        admit(scenario(text=text))


def test_a_controller_that_drives_past_the_filter_is_refused() -> None:
    admitted = admit(scenario("filters.py:Passes"))
    with pytest.raises(ControllerError, match="drives the arm past the safety filter"):
        run_kinematic(admitted, controller=admitted.servo())


def test_a_memory_of_earlier_episodes_is_noticed() -> None:
    admitted = admit(scenario("filters.py:Remembers", SHORT))
    repeatability = Repeatability()
    for _ in range(2):
        repeatability.add(run_kinematic(admitted))
    assert "or its safety filter" in repeatability.check().problem


def test_a_filter_without_memory_repeats_itself() -> None:
    repeatability = Repeatability()
    repeatability.add(run_with("filters.py:Halves", SHORT))
    assert not repeatability.check().problem


def test_the_claim_catches_needless_changes_and_no_others(
    without: Trace, halves: Trace, passes: Trace
) -> None:
    assert needless(without).verdict is Verdict.INCONCLUSIVE
    passing = needless(passes)
    assert (passing.verdict, passing.margin) == (Verdict.HOLDS, 1.0)
    needlessly = needless(halves)
    assert needlessly.verdict is Verdict.VIOLATED
    assert needlessly.worst_time_s == 0.0  # the hand is still far away, and the arm slow


def test_the_claim_agrees_with_a_bound_by_hand_of_one_command(halves: Trace) -> None:
    trace = halves
    still = replace(trace, filtered=trace.filtered.copy())
    evaluation = needless(still)
    tick = round(evaluation.worst_time_s / 0.008)
    hand_m = trace.ticks["hand_position_in_base_m"][tick, 0]
    room_m = float(trace.ticks["hand_distance_m"][tick, 0])
    rates = np.abs(trace.filtered["wanted_radps"][tick])
    fastest_mps = rates.sum() * 1.6  # no point of the arm is farther than that from any axis
    meets_s = 0.008 + fastest_mps / 1.0
    assert 2.0 * meets_s + fastest_mps * meets_s < room_m  # so the command was harmless indeed
    assert np.isfinite(hand_m).all()


def test_traces_keep_the_filter_and_refuse_a_lost_flag(halves: Trace, tmp_path: Path) -> None:
    trace = halves
    save_trace(trace, tmp_path / "a.trace")
    again = load_trace(tmp_path / "a.trace")
    for name in ("wanted_radps", "wanted_stop"):
        assert np.array_equal(again.filtered[name], trace.filtered[name])
    assert again.system.safety_filter == trace.system.safety_filter
    ticks = trace.ticks.copy()
    ticks["limits"] &= ~FLAG
    assert first_inconsistency(replace(trace, ticks=ticks)) is not None
    short = replace(trace, filtered=trace.filtered[:-1].copy())
    save_trace(short, tmp_path / "b.trace")
    with pytest.raises(TraceError, match="one a tick"):
        load_trace(tmp_path / "b.trace")


def test_a_scenario_without_a_filter_is_written_as_before() -> None:
    assert "\nsafety filter:" not in write_scenario(parse_scenario(SCENARIO), all_settings=True)
    assert '\nsafety filter: "filters.py:Passes"\n' in write_scenario(scenario("filters.py:Passes"))


def test_run_replay_and_attribute_name_the_filter() -> None:
    scenario("filters.py:Halves", SHORT)
    found = command("run", "visit.yaml", "--world", "kinematic", "--out", "out")
    assert "safety filter passes" in found.output
    assert "limits: safety filter passes: changed" in found.output
    assert "--safety-filter filters.py:Halves" in found.output
    report = json.loads(Path("out/report.json").read_text())
    (run,) = report["runs"]
    assert run["limits"]["by_limit"]["safety filter"] > 0
    trace = "out/traces/visit.trace"
    assert "expected the program named with --safety-filter" in command("replay", trace).output
    assert command("replay", trace, "--safety-filter", "filters.py:Halves").exit_code == 0
    assert command("replay", trace, "--safety-filter", "filters.py:Passes").exit_code == 2
    Path("filters.py").write_text(FILTERS + "\n# edited\n")
    edited = command("replay", trace, "--safety-filter", "filters.py:Halves")
    assert edited.exit_code == 2
    assert "as then" in edited.output
    assert command("attribute", trace, "--safety-filter", "filters.py:Halves").exit_code == 2
    Path("filters.py").write_text(FILTERS)
    assert command("attribute", trace, "--safety-filter", "filters.py:Halves").exit_code == 0


def test_attribution_leaves_the_filter_out(without: Trace) -> None:
    highest_mm = 1e3 * without.ticks["transform_tcp_to_base"][:50, 2, 3].max()  # of ``SHORT``
    line = f"  TCP height < {highest_mm + 10.0:.0f} mm: holds\n"
    scenario("filters.py:Upwards", SHORT.split("  no moving")[0] + line)
    command("run", "visit.yaml", "--world", "kinematic", "--out", "out")
    found = command("attribute", "out/traces/visit.trace", "--safety-filter", "filters.py:Upwards")
    assert found.exit_code == 0, found.output
    assert "safety filter (left out)" in found.output


def test_an_edited_filter_stops_a_campaign_that_goes_on(tmp_path: Path) -> None:
    text = SHORT.replace("scenario:", "scenario space:").replace(
        "wait: 300 ms", "wait: from 200 ms to 400 ms"
    )
    Path("space.yaml").write_text(text.replace("avoider:", "safety filter: filters.py:Halves\navoider:"))
    Path("plan.yaml").write_text(
        "plan: filters\nworld: kinematic\nseed: 1\nstrata:\n  - stratum: all\n    space: space.yaml\n"
        "    runs: 1\nclaims:\n  - claim: no moving part touches a hand\n"
    )
    first = command("campaign", "run", "plan.yaml", "--ledger", "c.sqlite", "--workers", "1")
    assert first.exit_code in (0, 1), first.output
    Path("filters.py").write_text(FILTERS.replace("0.5 *", "0.6 *"))
    second = command("campaign", "run", "plan.yaml", "--ledger", "c.sqlite", "--workers", "1")
    assert second.exit_code == 2
    assert "filters.py changed" in second.output


def test_the_worked_example_keeps_the_hand_away_and_its_page_says_so(tmp_path: Path) -> None:
    page = (ROOT / "docs/how-to/filter.md").read_text()
    text = next(block for block in re.findall(r"```yaml\n(.*?)```", page, re.DOTALL) if "claims:" in block)
    (tmp_path / "examples").mkdir()
    shutil.copy(ROOT / "examples/barrier_filter.py", tmp_path / "examples")
    Path("barrier.yaml").write_text(text)
    made = read_scenario(Path("barrier.yaml"))
    trace = run_kinematic(admit(made))
    for claim, evaluation in zip(made.claims, judge(trace), strict=True):
        assert evaluation.verdict is claim.expected, evaluation
    nearest_mm = float(trace.ticks["hand_distance_m"].min()) * 1e3
    assert f"at least {int(nearest_mm)} mm away" in page
    bare = run_kinematic(admit(replace(made, safety_filter="")))
    inside_mm = -min(item.margin or 0.0 for item in judge(bare)[1:2]) * 1e3
    assert f"{inside_mm:.0f} mm inside the wrist" in page


SLOWER = (
    SHORT
    + """\
  "eventually TCP speed > 40 mm/s": holds
  trace finite and monotone: holds
"""
)


def test_a_filter_is_compared_with_the_system_without_it(capsys: pytest.CaptureFixture[str]) -> None:
    """A filter that halves every command loses half of the speed, and breaks nothing."""
    scenario("filters.py:Halves", SLOWER)
    ended = command("run", "visit.yaml", "--world", "kinematic", "--against", "the unfiltered system")
    (run,) = json.loads(Path("reports/run/report.json").read_text())["against"]["runs"]
    changes = {claim["claim"]: claim["change"] for claim in run["claims"]}
    assert changes["eventually TCP speed > 40 mm/s"] == "new violation", ended.output
    assert changes["trace finite and monotone"] == "no difference"
    assert "the avoider answered" not in changes  # it is the same avoider
    assert "violates a claim that the unfiltered system keeps in 1 of 1 runs" in ended.output


def test_the_unfiltered_system_is_that_of_the_avoider_that_is_tested_and_needs_a_filter() -> None:
    own = scenario("filters.py:Halves", SHORT)
    tested, reference = accept(own, [("down", "--avoider"), (UNFILTERED, "--against")], lambda case: case)
    assert (tested.avoider, tested.safety_filter) == ("down", "filters.py:Halves")
    assert (reference.avoider, reference.safety_filter) == ("down", "")
    with pytest.raises(InadmissibleError, match="a scenario with a safety filter"):
        with_reference(replace(own, safety_filter=""), UNFILTERED, Place(field="--against"))
