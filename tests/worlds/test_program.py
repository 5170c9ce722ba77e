"""The user's own simulator: the same bits as ours, ways to be wrong, each a run error with its reason."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, scenario

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.avoiders import replay_command
from safety_harness.admission.trial import judge, run_all, run_trial
from safety_harness.base.exceptions import EditedProgramError, InadmissibleError, SimulationError, TraceError
from safety_harness.cell.simulation import worlds
from safety_harness.cell.simulation.worlds import (
    KINEMATIC,
    PYBULLET,
    WorldEntry,
    entry_of,
    world_named,
    world_of_trace,
)
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.cli.replay import replay
from safety_harness.cli.scenario_commands import run as run_files
from safety_harness.extensions.worlds.program import simulator
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.trace.store import load_trace, save_trace

EXAMPLES = Path(__file__).parents[2] / "examples" / "worlds"
KINEMATIC_CELL = EXAMPLES / "kinematic_cell.py"
CLAIMS = tuple(
    Claim(sentence=sentence, expected=Verdict.HOLDS)
    for sentence in ("hand distance never below 20 mm", "joint speeds within limits")
)


@pytest.fixture(autouse=True)
def _processes_end() -> Iterator[None]:
    yield
    simulator.cache_clear()


def command(file: Path) -> str:
    return f"exec:{sys.executable} {file}"


def visit(duration_s: float = 1.2) -> Admitted:
    return admit(replace(scenario(VISIT, duration_s=duration_s), claims=CLAIMS))


def in_world(file: Path) -> WorldEntry:
    return world_named(command(file), "--world")


def changed(tmp_path: Path, *changes: tuple[str, str]) -> WorldEntry:
    """Return the world of a simulator with changes of the shipped example."""
    text = KINEMATIC_CELL.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = tmp_path / "cell.py"
    file.write_text(text)
    return in_world(file)


def test_the_example_in_python_gives_the_bits_of_the_kinematic_world() -> None:
    theirs, ours = (run_trial(visit(2.0), world=world) for world in (in_world(KINEMATIC_CELL), KINEMATIC))
    assert theirs.ticks.tobytes() == ours.ticks.tobytes()
    assert theirs.decisions.tobytes() == ours.decisions.tobytes()
    assert [e.margin for e in judge(theirs)] == [e.margin for e in judge(ours)]


def test_the_example_in_c_gives_the_bits_of_the_kinematic_world(tmp_path: Path) -> None:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    subprocess.run([compiler, "-o", tmp_path / "cell", EXAMPLES / "kinematic_cell.c"], check=True)
    world = world_named(f"exec:{tmp_path / 'cell'}", "--world")
    assert (
        run_trial(visit(), world=world).ticks.tobytes() == run_trial(visit(), world=KINEMATIC).ticks.tobytes()
    )


def test_the_example_around_pybullet_gives_the_bits_of_pybullet() -> None:
    theirs, ours = (
        run_trial(visit(), world=world) for world in (in_world(EXAMPLES / "pybullet_cell.py"), PYBULLET)
    )
    assert theirs.ticks.tobytes() == ours.ticks.tobytes()


STATE = "joint_velocity_range_radps=[least_radps, most_radps],  # since the tick before"
RANGE = "        joint_velocity_range_radps=[least_radps, most_radps],  # since the tick before\n"
MOVE = "joints_rad = [q + dq * period_s for q, dq in zip(joints_rad, speeds_radps, strict=True)]"
SPEEDS = 'speeds_radps = message["joint_velocity_radps"]'
HELLO = 'say(say="hello", protocol="safety-harness world 1", name="kinematic cell", version="1")'
BOUND = HELLO.replace('version="1"', 'version="1", joint_acceleration_radps2=[40.0] * 6')
START = 'period_s, joints_rad = message["period_s"], message["joint_position_rad"]'
LATER = 'if message["tick"] == 120: '
WRONG = {
    "another tick": ("tick=tick,", "tick=tick + (tick == 120),", "its state is of tick 121"),
    "another time": ("time_s=tick * period_s", "time_s=tick * 0.01", "expected tick 1"),
    "degrees": (
        START,
        START + "\n        joints_rad = [57.3 * q for q in joints_rad]",
        "its joints begin at",
    ),
    "joints in another order": (
        START,
        START + "\n        joints_rad = joints_rad[::-1]",
        "its joints begin at",
    ),
    "a joint too few": (
        "joint_velocity_radps=speeds_radps",
        "joint_velocity_radps=speeds_radps[1:]",
        "6 finite",
    ),
    "no number": (MOVE, f"{MOVE}\n        {LATER}joints_rad[2] = float('nan')", "it sent no valid message"),
    "a jump": (MOVE, f"{MOVE}\n        {LATER}joints_rad[2] += 0.5", "joint 3 moves at"),
    "a speed outside its range": (
        "joint_velocity_range_radps=[least_radps, most_radps]",
        "joint_velocity_range_radps=[[1.0] * 6, [2.0] * 6]",
        "does not include joint_velocity_radps",
    ),
    "a TCP in another frame": (
        STATE,
        STATE + "\n        tcp_position_in_base_m=[0.0, 0.5, 0.3],",
        "its TCP is at",
    ),
    "a hand that is elsewhere": (
        STATE,
        STATE + "\n        hand_distance_m=0.01,",
        "its least hand distance is",
    ),
    "an unknown field": (STATE, STATE + "\n        temperature=3.0,", "it sent no valid message"),
    "an exit": (MOVE, f"{MOVE}\n        {LATER}sys.exit(3)", "3"),
    "a failure that it tells": (
        MOVE,
        f"{MOVE}\n        {LATER}say(say='failed', why='the emergency stop is pressed')",
        "the emergency stop is pressed",
    ),
    "a line without an end": (
        MOVE,
        f"{MOVE}\n        {LATER}print('x' * 70_000)",
        "longer than 65,536 bytes",
    ),
    "no answer": (MOVE, f"{MOVE}\n        {LATER}__import__('time').sleep(60)", "it gave no state within"),
    "a speed above the limit": (
        SPEEDS,
        f"{SPEEDS}\n        if message['tick'] == 120: speeds_radps = [9.0] * 6",
        "its limit is",
    ),
}


@pytest.mark.parametrize("way", WRONG)
def test_a_wrong_simulator_is_a_run_error_with_its_reason(way: str, tmp_path: Path) -> None:
    old, new, reason = WRONG[way]
    run = visit()
    if way == "no answer":
        clock = replace(run.scenario.settings.clock, wall_limit_s=0.3)
        settings = replace(run.scenario.settings, clock=clock)
        run = admit(replace(run.scenario, settings=settings))
    with pytest.raises(SimulationError, match=reason):
        run_trial(run, world=changed(tmp_path, (old, new)))


FOLLOWED = {
    "joints in another order after the start": 'speeds_radps = message["joint_velocity_radps"][::-1]',
    "another sign": 'speeds_radps = [-speed for speed in message["joint_velocity_radps"]]',
    "degrees a second": 'speeds_radps = [speed / 57.3 for speed in message["joint_velocity_radps"]]',
    "no motion": "speeds_radps = [0.0] * 6",
}


@pytest.mark.parametrize("way", FOLLOWED)
def test_a_simulator_whose_joints_do_not_follow_slow_set_points_is_refused(way: str, tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match="while its set point asks for"):
        run_trial(visit(), world=changed(tmp_path, (SPEEDS, FOLLOWED[way])))


FALSE_SPEEDS = {
    "half": "[0.5 * speed for speed in speeds_radps]",
    "another sign": "[-speed for speed in speeds_radps]",
    "zero": "[0.0] * 6",
}


@pytest.mark.parametrize("way", FALSE_SPEEDS)
def test_false_speeds_are_noticed_without_a_range_and_a_bound(way: str, tmp_path: Path) -> None:
    spoken = "joint_velocity_radps=speeds_radps,"
    world = changed(tmp_path, (RANGE, ""), (spoken, f"joint_velocity_radps={FALSE_SPEEDS[way]},"))
    with pytest.raises(SimulationError, match="its speeds do not explain"):
        run_trial(visit(), world=world)


def test_states_of_six_decimals_are_accepted(tmp_path: Path) -> None:
    whole = "json.dumps(message)"
    rounded = f"json.dumps(json.loads({whole}, parse_float=lambda text: round(float(text), 6)))"
    trace = run_trial(visit(), world=changed(tmp_path, (whole, rounded)))
    assert trace.complete
    assert [e.verdict for e in judge(trace)] == [
        e.verdict for e in judge(run_trial(visit(), world=KINEMATIC))
    ]


def test_one_number_bounds_the_acceleration_of_all_joints(tmp_path: Path) -> None:
    trace = run_trial(
        visit(), world=changed(tmp_path, (RANGE, ""), (HELLO, BOUND.replace("[40.0] * 6", "1e3")))
    )
    assert np.isfinite(trace.overshoot_radps).all()


def test_a_program_that_does_not_exist_is_bad_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = Path(__file__).parents[2] / "scenarios" / "first-run.yaml"
    assert run_files([file], tmp_path / "out", world="exec:./no-such-simulator") == BAD_INPUT
    assert "no such program" in capsys.readouterr().err


def test_a_joint_that_accelerates_beyond_its_bound_is_noticed(tmp_path: Path) -> None:
    world = changed(tmp_path, (RANGE, ""), (HELLO, BOUND.replace("40.0", "0.1")))
    with pytest.raises(SimulationError, match="beyond the bound that it states"):
        run_trial(visit(), world=world)


def test_a_run_goes_on_after_one_that_failed(tmp_path: Path) -> None:
    world = changed(tmp_path, (MOVE, f"{MOVE}\n        if message['tick'] == 120: sys.exit(3)"))
    short = visit(0.2)  # 25 ticks
    failed, fine = run_all([visit(), short], world)
    assert isinstance(failed, SimulationError)
    assert fine.ticks.tobytes() == run_trial(short, world=KINEMATIC).ticks.tobytes()  # type: ignore[union-attr]


def test_a_simulator_that_is_edited_between_two_runs_is_not_started_again(tmp_path: Path) -> None:
    world = changed(tmp_path, (MOVE, f"{MOVE}\n        if message['tick'] == 120: sys.exit(3)"))
    (failed,) = run_all([visit()], world)
    assert isinstance(failed, SimulationError)
    (tmp_path / "cell.py").write_text(KINEMATIC_CELL.read_text())
    with pytest.raises(EditedProgramError):
        run_trial(visit(0.2), world=world)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ((HELLO, HELLO.replace("world 1", "world 7")), "the protocol 'safety-harness world 1'"),
        (
            ("for line in sys.stdin:", "print('ready', flush=True)\nfor line in sys.stdin:"),
            "to be a simulator",
        ),
        (("for line in sys.stdin:", "sys.exit(1)\nfor line in sys.stdin:"), "to be a simulator"),
    ],
)
def test_a_program_that_is_no_simulator_is_refused(
    change: tuple[str, str], expected: str, tmp_path: Path
) -> None:
    with pytest.raises(InadmissibleError, match=expected):
        run_trial(visit(), world=changed(tmp_path, change))


def test_a_bound_of_the_wrong_length_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match="expected 6 numbers of at least 0, or one"):
        run_trial(visit(), world=changed(tmp_path, (HELLO, BOUND.replace("* 6", "* 5"))))


def test_without_bound_and_range_claims_between_ticks_are_inconclusive(tmp_path: Path) -> None:
    silent = run_trial(visit(), world=changed(tmp_path, (RANGE, "")))
    assert np.isinf(silent.overshoot_radps[:-1]).all()
    distance, _ = judge(silent)
    assert distance.verdict is Verdict.INCONCLUSIVE


def test_a_simulator_that_does_not_repeat_itself_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    noise = "[q + 1e-12 * __import__('random').random() for q in joints_rad]"
    run = run_trial(visit(), world=changed(tmp_path, (MOVE, f"{MOVE}\n        joints_rad = {noise}")))
    assert "other bits in a second episode" in dict(run.provenance.libraries)["simulator"]
    assert "does not repeat itself" in caplog.text
    run = run_trial(visit(), world=in_world(KINEMATIC_CELL))
    assert ", the same bits in a second episode" in dict(run.provenance.libraries)["simulator"]


def test_a_stored_trace_is_judged_but_never_starts_the_program(tmp_path: Path) -> None:
    made = run_trial(visit(), world=in_world(KINEMATIC_CELL))
    save_trace(made, tmp_path / "run.trace")
    stored = load_trace(tmp_path / "run.trace")
    assert [e.margin for e in judge(stored)] == [e.margin for e in judge(made)]
    assert world_of_trace(stored.provenance.world).name == stored.provenance.world  # the user has named it
    assert replay(tmp_path / "run.trace", world=command(KINEMATIC_CELL)) == AS_EXPECTED
    worlds._named.clear()
    with pytest.raises(TraceError):
        replay(tmp_path / "run.trace")
    with pytest.raises(TraceError, match="--world exec:"):
        replay(tmp_path / "run.trace", world="kinematic")
    assert entry_of(stored.provenance.world) is not None
    with pytest.raises(TraceError):
        world_of_trace(stored.provenance.world)


def test_run_takes_it_and_the_page_names_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = Path(__file__).parents[2] / "scenarios" / "first-run.yaml"
    assert run_files([file], tmp_path / "out", world=command(KINEMATIC_CELL)) == 0
    assert "kinematic_cell.py" in capsys.readouterr().out
    assert "kinematic cell 1, sha256" in (tmp_path / "out" / "report.html").read_text()


def test_an_edited_simulator_ends_the_job_and_the_next_job_begins_it_anew(tmp_path: Path) -> None:
    world = changed(tmp_path)
    first = run_trial(visit(), world=world)
    (tmp_path / "cell.py").touch()  # is no edit
    assert run_trial(visit(), world=world).ticks.tobytes() == first.ticks.tobytes()
    (tmp_path / "cell.py").write_text(KINEMATIC_CELL.read_text().replace('version="1"', 'version="22"'))
    with pytest.raises(EditedProgramError, match="files do not change while a job runs"):
        run_trial(visit(), world=world)
    with pytest.raises(EditedProgramError):  # and is no failed run
        list(run_all([visit()], world))
    second = run_trial(visit(), world=in_world(tmp_path / "cell.py"))
    said = [dict(trace.provenance.libraries)["simulator"] for trace in (first, second)]
    assert said[0].startswith("kinematic cell 1, sha256")
    assert said[1].startswith("kinematic cell 22, sha256")


def test_without_a_bound_of_speeds_a_violated_distance_is_reported_at_its_nearest_tick(
    tmp_path: Path,
) -> None:
    claim = Claim(sentence="hand distance never below 2 m", expected=Verdict.VIOLATED)
    admitted = admit(replace(scenario(VISIT, duration_s=1.2), claims=(claim,)))
    trace = run_trial(admitted, world=changed(tmp_path, (RANGE, "")))
    (found,) = judge(trace)
    nearest = int(trace.ticks["hand_distance_m"].min(axis=1).argmin())
    assert found.verdict is Verdict.VIOLATED
    assert nearest > 0
    assert found.worst_time_s == pytest.approx(nearest * 0.008)


def test_a_command_that_repeats_a_trace_names_its_simulator_and_no_world_of_ours() -> None:
    admitted, world = visit(0.2), in_world(KINEMATIC_CELL)
    trace = Path("a.trace")
    ours = replay_command(admitted.scenario, trace, made_in=KINEMATIC.name)
    theirs = replay_command(admitted.scenario, trace, made_in=world.name)
    assert theirs == f"{ours} {shlex.join(['--world', world.name])}"
