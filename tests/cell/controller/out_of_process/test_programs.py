"""Any program as a controller: what it does wrong costs its episode, with a reason, and nothing else."""

from __future__ import annotations

import itertools
import os
import random
import socket
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness.base.exceptions import ControllerError, InadmissibleError
from safety_harness.base.settings import DEFAULTS
from safety_harness.seams.contract import SIGHTS, Move, Seen, SeenHand, Stop, UserController
from tests.cell.controller.out_of_process.broken_runs import BrokenProgram
from tests.cell.controller.out_of_process.mutated_frames import MUTATIONS, is_an_answer
from tests.cell.controller.out_of_process.programs import ARM, START, WAYS, driven, made, program, seen

EXAMPLES = Path(__file__).parents[4] / "examples" / "controllers"
JOINT_FIELDS = SIGHTS[0].fields

HASTY = replace(DEFAULTS, clock=replace(DEFAULTS.clock, wall_limit_s=0.3))
REASONS = {
    "exit": "act: its process ended with exit status 3",
    "killed": "act: its process was ended by SIGKILL",
    "hang": "act: it gave no answer within 0.3 s of wall time",
    "flood of errors": "act: it gave no answer within 0.3 s of wall time",
    "memory": "act: its process ended with exit status 1",
    "another tick": "it answered tick 2 instead of tick 3",
    "a mode that is none": "mode must be one of: servoing",
    "failed": "act failed: no way",
    "hello again": "it has to say how to move; it said hello",
}

FAR = '{"say":"hello","protocol":"safety-harness controller 1","name":"far","sees":["hands"]}'


@pytest.fixture(autouse=True)
def _there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def breaks_once(controller: UserController) -> str:
    """Why an episode with the file failed, empty if it did not; the next one, without, is whole."""
    Path("break").touch()
    try:
        driven(controller, settings=HASTY)
        why = ""
    except ControllerError as error:
        why = str(error)
    os.remove("break")
    after = driven(controller)
    assert all(isinstance(action, Move) for action in after)
    assert after[3].tcp_velocity_mps.tolist() == [0.0, 0.0, 0.01]
    return why


@pytest.mark.parametrize("way", WAYS)
def test_what_a_program_does_wrong_costs_one_episode(way: str, tmp_path: Path) -> None:
    controller = made(program(tmp_path, way))
    why = breaks_once(controller)
    if way == "wrong shape":  # is for the loop to see, as with an action of any controller
        return
    assert why.startswith("act")
    assert "\n" not in why
    assert REASONS.get(way, "act") in why


def test_mutated_frames_cost_their_episode_or_are_answers(tmp_path: Path) -> None:
    """Fifty frames by lot, each mutation six times or more."""
    broken = BrokenProgram(tmp_path, "says")
    refused = 0
    for seed, mutation in zip(range(50), itertools.cycle(MUTATIONS.values())):
        frame = mutation(random.Random(seed))
        why = broken.episode(frame)
        assert (why and why.isprintable()) or is_an_answer(frame), frame[:200]
        refused += bool(why)
    assert refused > 25


@pytest.mark.parametrize(
    ("spoils", "why"),
    [
        (('"name": "upwards"', '"name": 3'), "no valid message"),
        (("controller 1", "controller 7"), "'safety-harness controller 7'"),
        (('["joints"]', '["walls"]'), "walls"),
        (("for line in sys.stdin:", "for line in []:"), "ended with exit status 0"),
        (("import json\n", "import jsonn\n"), "exit status 1"),
    ],
)
def test_a_program_that_is_no_controller_is_refused_at_once(
    spoils: tuple[str, str], why: str, tmp_path: Path
) -> None:
    reference = program(tmp_path)
    text = (tmp_path / "program.py").read_text()
    assert spoils[0] in text
    (tmp_path / "program.py").write_text(text.replace(*spoils))
    with pytest.raises(InadmissibleError) as caught:
        made(reference)
    assert why in str(caught.value)


@pytest.mark.parametrize(
    ("reference", "why"),
    [
        ("exec:", "exec: and a command"),
        ("exec:./gone", "no such program"),
        ('exec:"unclosed', "as a shell takes it"),
        ("tcp:example.org:1", "HOST one of"),
        ("tcp:localhost:0", "HOST one of"),
        ("unix:/gone", "no such socket"),
    ],
)
def test_a_reference_to_nothing_is_refused(reference: str, why: str) -> None:
    with pytest.raises(InadmissibleError) as caught:
        made(reference)
    assert why in str(caught.value)


def test_a_program_behind_a_socket_is_asked_in_the_same_words(tmp_path: Path) -> None:
    there = socket.socket(socket.AF_UNIX)
    there.bind("here")
    there.listen()
    heard: list[bytes] = []

    def serve() -> None:
        taken, _ = there.accept()
        with taken, taken.makefile("rwb", buffering=0) as line:
            for tick, message in enumerate(line, start=-2):
                heard.append(message)
                says = {-2: FAR, -1: '{"say":"ready"}'}
                line.write(says.get(tick, f'{{"say":"stop","tick":{tick}}}').encode() + b"\n")

    threading.Thread(target=serve, daemon=True).start()
    controller = made("unix:here")
    assert (controller.name, controller.sees) == ("far", ("hands",))
    assert len(driven(controller)) == 6
    there.close()
    assert b'"seed":"9223372036854775809"' in heard[1]
    assert b'"hands":[{"position_in_base_m":[0.5,-0.2,0.3]}]' in heard[2]
    assert b"joint_position_rad" not in heard[2]


def test_numbers_come_through_to_the_last_bit(tmp_path: Path) -> None:
    reference = program(tmp_path)
    file = tmp_path / "program.py"
    file.write_text(file.read_text().replace("[0,0,0.01]", "[0.1,1e-300,-0.3333333333333333]"))
    action = driven(made(reference))[0]
    assert isinstance(action, Move)
    assert np.array_equal(action.tcp_velocity_mps, [0.1, 1e-300, -1.0 / 3.0])


def test_the_ros_2_example_follows_its_rule_in_the_harness() -> None:
    controller = made(f'exec:"{sys.executable}" "{EXAMPLES / "ros2_stop_and_go.py"}" --harness')
    actions = driven(controller)
    assert all(isinstance(action, Move) for action in actions)
    tcp_in_base_m = seen(0).tcp_position_in_base_m
    assert actions[0].tcp_velocity_mps == pytest.approx(0.5 * (np.array([0.7, 0.0, 0.35]) - tcp_in_base_m))
    controller.reset(settings=DEFAULTS, arm=ARM, start=START, seed=1)
    near = Seen(
        time_s=0.0,
        period_s=0.008,
        **{name: getattr(seen(0), name) for name in JOINT_FIELDS},
        hands=(SeenHand(position_in_base_m=tcp_in_base_m + [0.0, 0.2, 0.0]),),
    )
    assert isinstance(controller.act(near), Stop)
