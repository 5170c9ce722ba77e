"""What becomes of a scenario does not depend on those that were admitted before it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from examples import Displaced, scenario
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper

from safety_harness.admission.admit import Admitter, admit, check
from safety_harness.admission.spaces import draw_admissible
from safety_harness.base.exceptions import InputError
from safety_harness.base.settings import DEFAULTS, Vector3
from safety_harness.scenario.model import Scenario
from safety_harness.search.trials import Trials, in_kinematic
from safety_harness.space.read import parse_space
from safety_harness.trace.trace import Trace

PROGRAM = """
from safety_harness import Proposal

class Up:
    name = "up"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, BY])

class Counting:
    name = "counting"

    def __init__(self):
        self.asked = 0

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        self.asked += 1
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.001 * self.asked])
"""
AVOIDERS = (
    "opposite pose",
    "nearest candidate",
    "mc-dropout",
    "mine.py:Up",
    "near.onnx",
    "none.py:Up",
    "nobody",
)
FOLDERS = ("a", "b")  # the same references mean other files
RADII_M = (0.05, 0.1, 0.15)
HANDS: tuple[Vector3, ...] = ((0.84, -0.35, 0.005), (0.95, -0.3, 0.0), (2.0, -0.35, 0.005))
DESIRED: tuple[Vector3, ...] = ((0.7, 0.0, 0.35), (0.69, 0.02, 0.36), (0.7, 0.0, 3.0))
Varied = tuple[str, str, float, Vector3, Vector3]


def near_hands_only() -> onnx.ModelProto:
    """A model with an answer for hands up to x = 0.9 m, and none for others."""
    vectors = ["n", 3]
    graph = helper.make_graph(
        [
            helper.make_node("Gather", ["hand_position_in_base_m", "first"], ["x"], axis=1),
            helper.make_node("Less", ["x", "far"], ["near"]),
            helper.make_node("Compress", ["tcp_position_in_base_m", "near"], ["position_in_base_m"], axis=0),
        ],
        "graph",
        [
            helper.make_tensor_value_info(name, TensorProto.DOUBLE, vectors)
            for name in ("hand_position_in_base_m", "tcp_position_in_base_m")
        ],
        [helper.make_tensor_value_info("position_in_base_m", TensorProto.DOUBLE, vectors)],
        [numpy_helper.from_array(np.array(0), "first"), numpy_helper.from_array(np.array(0.9), "far")],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("avoiders")
    for folder, by in zip(FOLDERS, ("0.05", "0.07"), strict=True):
        (root / folder).mkdir()
        (root / folder / "mine.py").write_text(PROGRAM.replace("BY", by))
        (root / folder / "near.onnx").write_bytes(near_hands_only().SerializeToString())
    return root


def varied(root: Path, what: Varied) -> Scenario:
    folder, avoider, radius_m, hand, desired = what
    own = replace(DEFAULTS.avoidance, radius_m=radius_m, nominal_hand_position_in_base_m=hand)
    cell = replace(DEFAULTS.cell, desired_tcp_position_in_base_m=desired)
    one = scenario(avoider=avoider, settings=replace(DEFAULTS, avoidance=own, cell=cell))
    return replace(one, file=root / folder / "f.yaml")


def outcome(admitter: Admitter, one: Scenario) -> object:
    """Why it is refused, or who avoids, what that answers and what it was trained on."""
    try:
        admitted = admitter.admit(one)
    except InputError as error:
        return str(error)
    answers = [
        admitted.avoider.propose(
            hand_position_in_base_m=np.array([0.8, -0.3, 0.1]),
            tcp_position_in_base_m=np.array([0.7, 0.0, 0.35]),
            seed=seed,
        ).position_in_base_m.tobytes()
        for seed in (1, 2)
    ]
    return admitted.avoider.name, admitted.avoider_sha256, answers, admitter.seen_of(one)


_ALONE: dict[Varied, object] = {}


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.tuples(
            st.sampled_from(FOLDERS),
            st.sampled_from(AVOIDERS),
            st.sampled_from(RADII_M),
            st.sampled_from(HANDS),
            st.sampled_from(DESIRED),
        ),
        min_size=2,
        max_size=6,
    )
)
@example([("a", "opposite pose", radius_m, HANDS[0], DESIRED[0]) for radius_m in RADII_M])
@example([("a", "mc-dropout", 0.1, hand, DESIRED[0]) for hand in HANDS])
@example([("a", "near.onnx", 0.1, hand, DESIRED[0]) for hand in HANDS])
@example([(folder, "mine.py:Up", 0.1, HANDS[0], DESIRED[0]) for folder in FOLDERS])
def test_a_scenario_is_admitted_as_if_it_were_alone(root: Path, several: list[Varied]) -> None:
    admitter = Admitter()
    for what in several:
        one = varied(root, what)
        if what not in _ALONE:
            _ALONE[what] = outcome(Admitter(), one)
        assert outcome(admitter, one) == _ALONE[what]


def test_the_outcomes_that_are_compared_differ(root: Path) -> None:
    def of(folder: str, avoider: str, radius_m: float = 0.1, hand: int = 0) -> object:
        return outcome(Admitter(), varied(root, (folder, avoider, radius_m, HANDS[hand], DESIRED[0])))

    assert of("a", "opposite pose", 0.05) != of("a", "opposite pose", 0.15)
    assert of("a", "mine.py:Up") != of("b", "mine.py:Up")
    assert "another workspace" in str(of("a", "mc-dropout", hand=2))
    assert isinstance(of("a", "mc-dropout"), tuple)
    assert "shape of (1, 3)" in str(of("a", "near.onnx", hand=1))
    assert isinstance(of("a", "near.onnx"), tuple)
    assert of("a", "opposite pose", hand=0) != of("a", "opposite pose", hand=1)  # another seen space


def test_a_program_is_made_once_and_keeps_its_memory_whatever_the_settings(root: Path) -> None:
    admitter = Admitter()
    made = [
        admitter.admit(varied(root, ("a", "mine.py:Counting", radius_m, HANDS[0], DESIRED[0]))).avoider
        for radius_m in RADII_M
    ]
    assert made[0] is made[1] is made[2]
    assert admit(varied(root, ("a", "mine.py:Counting", 0.1, HANDS[0], DESIRED[0]))).avoider is not made[0]


def test_a_scenario_is_checked_without_its_avoider(root: Path) -> None:
    one = varied(root, ("a", "none.py:Up", 0.1, HANDS[0], DESIRED[0]))
    checked, admitted = check(one), admit(replace(one, avoider="opposite pose"))
    assert np.array_equal(checked.joint_position_rad, admitted.joint_position_rad)
    with pytest.raises(InputError, match="can reach"):
        check(varied(root, ("a", "opposite pose", 0.1, HANDS[0], DESIRED[2])))


TEXT = """\
scenario space: a radius that varies
duration: 1 s
avoider: opposite pose
tcp start:
  offset: [0 mm, 0 mm, 0 mm]
settings:
  avoidance: {radius: from 50 mm to 150 mm}
hands:
  - hand: right
    starts at: [840 mm, -350 mm, 250 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves: [{wait: 1 s}]
claims: {hand distance never below 50 mm: holds}
"""


def test_each_point_of_a_space_has_the_radius_of_its_own() -> None:
    space, admitter = parse_space(TEXT), Admitter()
    found = [admitter.admit(space.at(np.array([u]), seed=0)) for u in (0.0, 0.5, 1.0)]
    assert [one.avoider.radius_m for one in found] == pytest.approx(RADII_M)  # type: ignore[attr-defined]


HAND_VARIES = TEXT.replace("opposite pose", "mc-dropout").replace(
    "{radius: from 50 mm to 150 mm}",
    "{nominal hand position: {one of: [[840 mm, -350 mm, 5 mm], [2 m, -350 mm, 5 mm]]}}",
)


def test_no_point_and_no_draw_is_let_through_for_those_before_it() -> None:
    space = parse_space(HAND_VARIES)
    assert not Trials(space, in_kinematic)(np.array([[0.2]]), 0).refused[0]
    for several in ([[0.8]], [[0.2], [0.8]]):
        with pytest.raises(InputError, match="another workspace"):
            Trials(space, in_kinematic)(np.array(several), 0)
    with pytest.raises(InputError, match="another workspace"):
        draw_admissible(space, seed=1, count=20)


def test_the_trace_of_every_run_of_a_search_says_which_file_its_avoider_came_from(root: Path) -> None:
    runs: list[Trace | Exception] = []

    def world(admitted: object) -> list[Trace | Exception]:
        found = in_kinematic(admitted)  # type: ignore[arg-type]
        runs.extend(found)
        return found

    reference = f"{root / 'a' / 'mine.py'}:Up"
    Trials(parse_space(TEXT), world, avoider=reference)(np.array([[0.0], [1.0]]), 0)
    hashes = {run.system.tested.sha256 for run in runs if isinstance(run, Trace)}
    assert len(runs) == 2
    assert len(hashes) == 1
    assert "" not in hashes


def test_what_is_given_in_place_of_the_named_avoider_is_used_as_it_is() -> None:
    avoider = Displaced((0.0, 0.0, 0.05))
    assert admit(scenario(), avoider=avoider).avoider is avoider
