"""The paper's trial in PyBullet: servo, give way once at the 100th iteration to a constant hand, servo on.

As in the paper the trigger comes at a given iteration, whatever the distance, and the hand is a position that
stays where it is.  Everything else is the system itself: the compiled control stack, its limits, the arm's
motors and physics.  Counted are the control ticks from the arrival at the repulsive position to the gain
switch.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted, admit
from safety_harness.base.exceptions import InadmissibleError
from safety_harness.base.geometry.regions import Region
from safety_harness.base.settings import GateKind, Settings, Vector3
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.gate import Gate, Query
from safety_harness.cell.avoidance.simple import OppositePose
from safety_harness.cell.controller.records import (
    ANSWER,
    COMMAND,
    AnswerRecords,
    CommandRecords,
    FilterRecords,
    ObservationRecords,
    ParameterRecords,
    StateRecords,
    TrackRecords,
    initial_state,
    parameters,
)
from safety_harness.cell.controller.stack import begin_tick, finish_tick
from safety_harness.cell.perception.hand_filter import filter_parameters
from safety_harness.cell.perception.tracking import no_tracks
from safety_harness.cell.robot.robots import arm_capsules, inverse_kinematics
from safety_harness.cell.simulation.pybullet_world import PyBulletWorld
from safety_harness.extensions.lab.learning.evaluation import leaf
from safety_harness.scenario.model import PoseStart, Scenario
from safety_harness.space.regions import paper_seen, region_named
from safety_harness.trace.records import Mode
from safety_harness_paper.avoiders import NONE, with_networks
from safety_harness_paper.work import Done, Json, Task

TRIGGER_TICK = 100  # figures 7 and 8
LIMIT_S = 24.0  # after the arrival; the closed form takes under 6 s from half a metre
LOST_S = 1.0  # standing still without the object: it never comes back
FEW, MANY = "few", "many"
_DRAW = 3


@dataclass(frozen=True, kw_only=True)
class Trial:
    """What became of one: ``fate`` is converged, refused (by the reach gate), lost, stopped or never.

    ``iterations`` (None unless converged) are ticks from arrival, or from the trigger without avoidance.
    """

    fate: str
    iterations: int | None
    arrival_error_m: float  # distance of the TCP from the desired position when counting begins
    record: dict[str, Any] = field(default_factory=dict)


def measurement(
    models: tuple[Task, ...], *, trials: int, few: int, root: int, k: int, settings: Settings
) -> Task:
    """DNN, Bayesian DNN and ensemble of the k-th training seed, and the others, on the same TCPs."""
    return Task(
        f"PyBullet trials, draw {k}",
        measure,
        (
            ("trials", trials),
            ("few", few),
            ("draw_seed", leaf(root, _DRAW, k)),
            ("few_seed", leaf(root, _DRAW)),
            ("settings", settings),
        ),
        models,
        seconds=5.0 + 7 * 0.1 * (trials + few),
    )


def measure(
    folder: Path, *models: Done, trials: int, few: int, draw_seed: int, few_seed: int, settings: Settings
) -> Json:
    """{"few" and "many": {"redrawn": n, "systems": {name: {"fates": [...], "iterations": [...]}}}}."""
    systems: dict[str, Avoider | None] = {NONE: None, **with_networks(settings, *models)}
    return {
        name: _on_draws(systems, count, seed, settings, record=name == FEW)
        for name, count, seed in ((FEW, few, few_seed), (MANY, trials, draw_seed))
    }


def _on_draws(
    systems: Mapping[str, Avoider | None], count: int, seed: int, settings: Settings, *, record: bool
) -> Json:
    starts, redrawn = starts_of(settings, count, seed)
    hand = np.array(settings.avoidance.nominal_hand_position_in_base_m)
    found: dict[str, Any] = {}
    records: dict[str, Any] = {}
    for name, avoider in systems.items():
        done = [
            run(start, avoider, hand, seed=number, record=record and number == 0)
            for number, start in enumerate(starts)
        ]
        found[name] = {
            "fates": [one.fate for one in done],
            "iterations": [one.iterations for one in done],
            "arrival_error_m": [one.arrival_error_m for one in done],
        }
        records[name] = done[0].record
    return {"redrawn": redrawn, "systems": found} | ({"records": records} if record else {})


def starts_of(
    settings: Settings,
    count: int,
    seed: int,
    *,
    region: Region | None = None,
    tilt_rad: Vector3 = (0.0, 0.0, 0.0),
) -> tuple[list[Admitted], dict[str, int]]:
    """TCP starts outside the training range that can be tried, and why others were drawn again."""
    space = region or region_named("unseen tcp", paper_seen(settings), settings)
    rng = np.random.default_rng(seed)
    starts: list[Admitted] = []
    redrawn: Counter[str] = Counter()
    while len(starts) < count:
        x, y, z = (float(value) for value in space.draw(rng, 1)[0])
        try:
            starts.append(
                admit(
                    _scenario((x, y, z), tilt_rad, settings),
                    avoider=OppositePose(settings.avoidance.radius_m),
                )
            )
        except InadmissibleError as error:
            redrawn[error.expected] += 1
    return starts, dict(redrawn)


def _scenario(position_in_base_m: Vector3, tilt_rad: Vector3, settings: Settings) -> Scenario:
    return Scenario(
        name="trial",
        title="a trial",
        about="",
        duration_s=LIMIT_S,
        seed=0,
        start=PoseStart(position_in_base_m=position_in_base_m, tilt_in_tcp_rad=tilt_rad),
        hands=(),
        avoider="opposite pose",
        claims=(),
        settings=settings,
    )


def run(
    start: Admitted,
    avoider: Avoider | None,
    hand_in_base_m: NDArray[np.float64],
    *,
    seed: int,
    record: bool = False,
) -> Trial:
    """One trial; without an avoider servoing just goes on."""
    settings = start.scenario.settings
    period_s = settings.clock.control_period_s
    servo = _TriggeredServo(start, avoider, hand_in_base_m, seed)
    kept: list[tuple[NDArray[np.float64], ...]] = []
    counted_from: int | None = None
    lost = 0
    trial = Trial(fate="never", iterations=None, arrival_error_m=float("nan"))
    with PyBulletWorld(start.scenario, start.arm, start.joint_position_rad) as world:
        most = TRIGGER_TICK + ceil((LIMIT_S + 10.0) / period_s)
        for tick in range(most):
            command = servo.step(world.observe(), tick)
            state = servo.state[0]
            if record:
                kept.append(
                    (
                        state["feature_error"].copy(),
                        state["camera_twist"].copy(),
                        np.array([state["sse"], state["gain"], state["mode"]]),
                    )
                )
            if servo.refused:
                return replace(trial, fate="refused")
            mode = int(state["mode"])
            if counted_from is None and tick >= TRIGGER_TICK and mode == Mode.SERVOING:
                counted_from = tick
                way = state["transform_tcp_to_base"][:3, 3] - settings.cell.desired_tcp_position_in_base_m
                trial = replace(trial, arrival_error_m=float(np.linalg.norm(way)))
            if counted_from is not None:
                if state["sse"] < settings.servo.gain_switch_sse:
                    trial = replace(trial, fate="converged", iterations=tick - counted_from)
                    break
                if (tick - counted_from) * period_s >= LIMIT_S:
                    break
            lost = lost + 1 if mode == Mode.OBJECT_LOST else 0
            if lost * period_s >= LOST_S or mode == Mode.PROTECTIVE_STOP:
                trial = replace(trial, fate="lost" if lost else "stopped")
                break
            world.step(command)
        if record and trial.fate == "converged":
            _servo_on(servo, world, kept, round(1.0 / period_s))
    if not np.isfinite(trial.arrival_error_m):
        trial = replace(trial, arrival_error_m=-1.0)
    return replace(trial, record=_record(kept, servo, counted_from, trial)) if record else trial


def _servo_on(
    servo: _TriggeredServo, world: PyBulletWorld, kept: list[tuple[NDArray[np.float64], ...]], ticks: int
) -> None:
    """A second more, so that a figure shows what follows the gain switch."""
    first = len(kept)
    for tick in range(first, first + ticks):
        command = servo.step(world.observe(), tick)
        state = servo.state[0]
        kept.append(
            (
                state["feature_error"].copy(),
                state["camera_twist"].copy(),
                np.array([state["sse"], state["gain"], state["mode"]]),
            )
        )
        world.step(command)


def _record(
    kept: list[tuple[NDArray[np.float64], ...]],
    servo: _TriggeredServo,
    counted_from: int | None,
    trial: Trial,
) -> Json:
    """Time series for figures 7 and 8; what was not seen is null."""
    features, twists, rest = (np.array([row[i] for row in kept]) for i in range(3))

    def plain(array: NDArray[np.float64]) -> list[Any]:
        return [[float(f"{v:.6g}") if np.isfinite(v) else None for v in row] for row in array]

    switch = None if trial.iterations is None or counted_from is None else counted_from + trial.iterations
    return {
        "trigger": TRIGGER_TICK,
        "arrival": counted_from,
        "switch": switch,
        "feature_error": plain(features),
        "camera_twist": plain(twists),
        "sse_gain_mode": plain(rest),
        "proposed_in_base_m": None if servo.proposed is None else servo.proposed.tolist(),
    }


class _TriggeredServo:
    """The control stack with a trigger of its own: no hand is ever seen, one decision is made."""

    def __init__(
        self, start: Admitted, avoider: Avoider | None, hand_in_base_m: NDArray[np.float64], seed: int
    ) -> None:
        assert start.view is not None
        settings = start.scenario.settings
        self._avoider, self._hand, self._seed = avoider, hand_in_base_m, seed
        reach = replace(settings, avoidance=replace(settings.avoidance, gate=GateKind.REACH))
        self._gate = Gate.from_settings(
            reach, inverse_kinematics(start.scenario.robot), arm_capsules(start.scenario.robot)
        )
        self._parameters = ParameterRecords(parameters(settings, start.arm, start.view))
        self._filter = FilterRecords(filter_parameters(settings.hand_filter, settings.hand_sensor))
        self._tracks = TrackRecords(no_tracks())
        self._answer = AnswerRecords(np.zeros(1, ANSWER))
        self._command = CommandRecords(np.zeros(1, COMMAND))
        self.state = StateRecords(initial_state())
        self.proposed: NDArray[np.float64] | None = None
        self.refused = False

    def step(self, observation: NDArray[np.void], tick: int) -> NDArray[np.void]:
        """One tick; at the trigger the avoider is asked, and refused if the arm cannot go there."""
        seen = ObservationRecords(observation)
        begin_tick(self._parameters, self._filter, self.state, self._tracks, seen)
        if tick == TRIGGER_TICK and self._avoider is not None:
            self._decide(self._avoider, observation)
        finish_tick(self._parameters, self.state, seen, self._answer, self._command)
        return self._command

    def _decide(self, avoider: Avoider, observation: NDArray[np.void]) -> None:
        pose = self.state[0]["transform_tcp_to_base"].copy()
        tcp = pose[:3, 3].copy()
        proposal = avoider.propose(
            hand_position_in_base_m=self._hand, tcp_position_in_base_m=tcp, seed=self._seed
        )
        query = Query(self._hand, tcp, pose, observation[0]["joint_position_rad"].copy(), self._hand[None], 0)
        self.proposed = proposal.position_in_base_m
        self.refused = bool(self._gate.check(proposal.position_in_base_m, query))
        self._answer["stop"] = False
        self._answer["position_in_base_m"] = proposal.position_in_base_m
        self.state["decision_pending"] = True
