"""What does a control tick cost, next to its physics and a naive loop?  Run: python benchmarks/loop.py.

Loops take turns on the same scenarios in one process, so that a busy machine slows all of them; a
ratio is formed within each turn and printed as median (least to greatest).
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import importlib.util
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
from numpy.typing import NDArray
from ratios import Ratio, say

from safety_harness.admission.admit import Admitted, admit
from safety_harness.cell.avoidance.gate import Gate
from safety_harness.cell.controller import controller
from safety_harness.cell.simulation import pybullet_world
from safety_harness.cell.simulation.cell import build_cell
from safety_harness.cell.simulation.engine import pybullet
from safety_harness.cell.simulation.pybullet_world import PyBulletWorld
from safety_harness.cell.simulation.simulate import simulate
from safety_harness.scenario.read import read_scenario
from safety_harness.trace.records import Mode
from safety_harness.trace.trace import Trace

SCENARIOS = Path(__file__).parents[1] / "scenarios"
NAMES = ("hand-visits-and-leaves", "hand-stays")
TURNS = 7
CHUNK = 25  # ticks of the whole loop between two turns of the physics alone
NAIVE_TICKS = 24  # a turn, evenly spread over the scenario
LARGEST_OVERHEAD = 1.5  # of everything around stepSimulation, times the physics
AIMED_SPEEDUP = 400.0


METHOD = f"""\
Method: every maths library on one thread, {TURNS} turns, the exact camera.
A turn is a run of the whole loop; after every {CHUNK} of its ticks the physics alone repeats them (the
same cell and motor targets, only stepSimulation timed; it has to end at the same joint angles, bit for
bit), and after the run the naive loop does {NAIVE_TICKS} ticks, evenly spread over the scenario.
Naive tick: a 640x480 image by PyBullet's software renderer, with the arm's visual meshes loaded, OpenCV
threshold, moments, interaction matrix and pinv in numpy, the same sub-steps, getClosestPoints to the hand; if
critical, ten eager passes of a regression ResNet with dropout (width 32, 7 to 3; untrained weights) in torch.
Critical ticks: a predicted hand is within the critical distance.  Values: median (least to greatest)."""


@dataclass(frozen=True)
class Recorded:
    """A scenario and its run, which all loops repeat."""

    admitted: Admitted
    trace: Trace

    @property
    def critical(self) -> NDArray[np.bool_]:
        """(n,) the ticks in which a predicted hand is within the critical distance."""
        within: NDArray[np.bool_] = (
            self.trace.ticks["predicted_distance_m"]
            < self.admitted.scenario.settings.avoidance.critical_distance_m
        )
        return within


class PhysicsAlone:
    """The same cell and motor targets as in a recorded run, with only stepSimulation timed."""

    def __init__(self, recorded: Recorded) -> None:
        admitted, ticks = recorded.admitted, recorded.trace.ticks
        if (ticks["mode"] == int(Mode.PROTECTIVE_STOP)).any():
            raise ValueError("in a protective stop the motor targets are not the demanded velocities")
        settings = admitted.scenario.settings
        self.total_s = 0.0
        self._substeps = settings.clock.physics_substeps
        self._targets = ticks["demanded_joint_velocity_radps"][:-1].tolist()
        self._end = ticks["joint_position_rad"][-1].tolist()
        self._done = 0
        self._efforts = admitted.arm.effort_limit.tolist()
        self._client = int(pybullet.connect(pybullet.DIRECT))
        bodies = build_cell(self._client, settings, admitted.arm, admitted.joint_position_rad, rendered=False)
        self._robot, self._joints = bodies.robot, list(bodies.joints)

    def advance(self, done: int) -> None:
        """Repeat the ticks up to ``done``."""
        for targets in self._targets[self._done : done]:
            pybullet.setJointMotorControlArray(
                self._robot,
                self._joints,
                pybullet.VELOCITY_CONTROL,
                targetVelocities=targets,
                forces=self._efforts,
                physicsClientId=self._client,
            )
            start = time.perf_counter()
            for _ in range(self._substeps):
                pybullet.stepSimulation(physicsClientId=self._client)
            self.total_s += time.perf_counter() - start
        self._done = min(done, len(self._targets))

    def close(self) -> None:
        """Give the client back; RuntimeError if the physics did not end where the recorded run did."""
        states = pybullet.getJointStates(self._robot, self._joints, physicsClientId=self._client)
        pybullet.disconnect(physicsClientId=self._client)
        if [state[0] for state in states] != self._end:
            raise RuntimeError("the replayed physics did not end where the recorded run did")


def whole_loop(admitted: Admitted, physics: PhysicsAlone | None = None) -> tuple[float, Trace]:
    """(seconds a tick, trace) of the product's loop; building the world is not counted.

    Given ``physics``, it catches up every CHUNK ticks, and its time is not counted either.
    """
    elsewhere_s = 0.0

    def take_turns(done: int) -> None:
        nonlocal elsewhere_s
        if physics is not None and (done % CHUNK == 0 or done > admitted.scenario.ticks):
            start = time.perf_counter()
            physics.advance(done)
            elsewhere_s += time.perf_counter() - start

    with PyBulletWorld(admitted.scenario, admitted.arm, admitted.joint_position_rad) as world:
        pilot = admitted.controller()
        start = time.perf_counter()
        trace = simulate(world, pilot, admitted.scenario, on_tick=take_turns)
        total_s = time.perf_counter() - start - elsewhere_s
    return total_s / admitted.scenario.ticks, trace


def naive_sample(recorded: Recorded) -> NDArray[np.int64]:
    """(NAIVE_TICKS,) evenly spread ticks."""
    return np.linspace(0, len(recorded.trace.ticks) - 1, NAIVE_TICKS).round().astype(np.int64)


def naive_time(loop: Any, recorded: Recorded) -> float:
    """Seconds a tick of the naive loop."""
    total_s = 0.0
    for k in naive_sample(recorded):
        loop.place(recorded.trace.ticks[k])
        start = time.perf_counter()
        loop.tick(critical=bool(recorded.critical[k]))
        total_s += time.perf_counter() - start
    return total_s / NAIVE_TICKS


@contextmanager
def naive_loop(admitted: Admitted) -> Iterator[Any]:
    """The naive loop, or None without torch."""
    if importlib.util.find_spec("torch") is None:
        yield None
        return
    from naive_loop import NaiveLoop

    with NaiveLoop(admitted) as loop:
        yield loop


def measured(recorded: Recorded) -> tuple[list[float], list[float], list[float]]:
    """Seconds a tick, in turns: the whole loop, the physics alone, the naive loop (none without torch)."""
    loops: list[float] = []
    physics: list[float] = []
    naive: list[float] = []
    with naive_loop(recorded.admitted) as loop:
        for _ in range(TURNS):
            alone = PhysicsAlone(recorded)
            loops.append(whole_loop(recorded.admitted, alone)[0])
            alone.close()
            physics.append(alone.total_s / recorded.admitted.scenario.ticks)
            if loop is not None:
                naive.append(naive_time(loop, recorded))
    return loops, physics, naive


def compare(recorded: Recorded) -> None:
    """Let the loops take turns; print their times and ratios."""
    loops, physics, naive = measured(recorded)
    around = [(a - b) / b for a, b in zip(loops, physics, strict=True)]
    say("whole loop", [1e6 * a for a in loops], "us a tick")
    say("stepSimulation alone", [1e6 * b for b in physics], "us a tick")
    met = "met" if median(around) <= LARGEST_OVERHEAD else "NOT MET"
    say("around stepSimulation", around, f"x the physics (at most {LARGEST_OVERHEAD:g}: {met})")
    if not naive:
        print("  naive loop              skipped: torch is not installed (pip install -e '.[benchmarks]')")
        return
    say("naive loop", [1e6 * c for c in naive], "us a tick")
    ratios = [c / a for a, c in zip(loops, naive, strict=True)]
    say("naive loop", ratios, f"x the whole loop (aim: {AIMED_SPEEDUP:g})")


class Stopwatch:
    """Adds up the time spent in the functions that it wraps."""

    def __init__(self) -> None:
        self.total_s: dict[str, float] = {}

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """``function`` with its time added to ``part``."""
        self.total_s.setdefault(part, 0.0)

        def wrapped(*args: Any, **kwargs: Any) -> Any:
            start = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                self.total_s[part] += time.perf_counter() - start

        return wrapped

    def on(self, part: str, owner: Any, name: str) -> Any:
        """A patch that times ``owner.name`` while it lasts."""
        return patch.object(owner, name, self.timed(part, getattr(owner, name)))


def where_the_time_goes(admitted: Admitted) -> dict[str, float]:
    """Microseconds a tick of each part, from one run with a stopwatch on every part."""
    watch = Stopwatch()
    engine = SimpleNamespace(**vars(pybullet))
    engine.stepSimulation = watch.timed("stepSimulation", pybullet.stepSimulation)
    engine.setJointMotorControlArray = watch.timed("motor command", pybullet.setJointMotorControlArray)
    engine.getJointStates = watch.timed("joint states", pybullet.getJointStates)
    with (
        patch.object(pybullet_world, "pybullet", engine),
        watch.on("drives", pybullet_world, "drive_on"),
        watch.on("hands, truth", pybullet_world, "move_on"),
        watch.on("observe", PyBulletWorld, "observe"),
        watch.on("look", controller, "look"),
        watch.on("decide", controller.AvoidingServo, "decide"),
        watch.on("rule", Gate, "rule"),
        watch.on("act", controller, "act"),
        watch.on("report, recording", controller.AvoidingServo, "report"),
        watch.on("report, recording", PyBulletWorld, "true_state"),
    ):
        tick_s, _ = whole_loop(admitted)
    parts = {part: 1e6 * total_s / admitted.scenario.ticks for part, total_s in watch.total_s.items()}
    parts["rest (Python between them)"] = 1e6 * tick_s - sum(parts.values())
    return parts


def print_parts(admitted: Admitted) -> None:
    """Medians over the turns, the largest first."""
    turns = [where_the_time_goes(admitted) for _ in range(TURNS)]
    rows = {part: [turn[part] for turn in turns] for part in turns[0]}
    shares = {part: median(turn[part] / turn["stepSimulation"] for turn in turns) for part in rows}
    print("  where the time goes           us a tick (least to greatest)   x stepSimulation")
    for part in sorted(rows, key=lambda part: -median(rows[part])):
        values = rows[part]
        spread = f"({min(values):.2f} to {max(values):.2f})"
        print(f"    {part:28}{median(values):9.2f}  {spread:20}{shares[part]:10.3f}")


def recorded_run(name: str) -> Recorded:
    """A shipped scenario and its run."""
    admitted = admit(read_scenario(SCENARIOS / f"{name}.yaml"))
    return Recorded(admitted, whole_loop(admitted)[1])


def ratios() -> list[Ratio]:
    """What stands around the physics, and the naive loop over ours."""
    cv2.setNumThreads(1)
    rows = []
    for name in NAMES:
        loops, physics, naive = measured(recorded_run(name))
        around = [(a - b) / b for a, b in zip(loops, physics, strict=True)]
        what = f"around stepSimulation, over it ({name})"
        rows.append(Ratio.of(what, around, aim=LARGEST_OVERHEAD, at_most=True))
        what, note = f"naive loop over ours ({name})", f"ours {1e6 * median(loops):.0f} us a tick"
        if not naive:
            rows.append(Ratio.missing(what, "torch is not installed"))
            continue
        each = [c / a for a, c in zip(loops, naive, strict=True)]
        rows.append(Ratio.of(what, each, aim=AIMED_SPEEDUP, note=note))
    return rows


def main() -> None:
    """Print everything."""
    cv2.setNumThreads(1)
    print(METHOD)
    for name in NAMES:
        recorded = recorded_run(name)
        admitted = recorded.admitted
        clock, critical = admitted.scenario.settings.clock, recorded.critical
        sampled = critical[naive_sample(recorded)]
        print(
            f"\n{name}: {admitted.scenario.ticks} ticks, {clock.physics_substeps} sub-steps each, "
            f"{critical.mean():.1%} critical ({sampled.mean():.1%} of the naive sample), "
            f"{len(recorded.trace.decisions)} decisions"
        )
        compare(recorded)
        print_parts(admitted)


if __name__ == "__main__":
    main()
