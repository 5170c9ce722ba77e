"""Write docs/results/controllers.md: the controllers that ship, and how each behaves in every shipped space.

Run: python benchmarks/shipped_controllers.py [--draws N] [--out FILE] (some minutes).

The same draws for all, none of which training has had, in the kinematic world.  The visual servo asks the
avoider of the space.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import hashlib
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from safety_harness.admission.admit import Admitter
from safety_harness.admission.avoiders import with_avoider
from safety_harness.admission.claims import property_of
from safety_harness.admission.spaces import draw_admissible
from safety_harness.admission.trial import run_kinematic
from safety_harness.cell.controller.named import LEARNED_FILE, NAMES
from safety_harness.claims.properties.base import Property
from safety_harness.scenario.model import VISUAL_SERVO, Claim, Driver, Scenario, Verdict
from safety_harness.space.read import read_space
from safety_harness.trace.trace import Trace

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "results" / "controllers.md"
KEPT = ("TCP speed never above 250 mm/s", "joint speeds within limits", "joint positions within limits")
NEAR = "hand distance never below 50 mm"
ARRIVED_M = 0.02
TRAINED_IN, STREAM = "reaching-hands", 1000  # of the seed tree; training has had 0 to 127
CARDS = """\
<!-- reader: research; written by: benchmarks/shipped_controllers.py; question: How good are they? -->

# Controllers that ship

`make bench-shipped_controllers` writes this page. A scenario file selects a controller with the key
`controller:`, and a command with the option `--controller`; see [controllers](../how-to/controller.md). Each
controller violates `{near}` in some runs; the last table shows in how many.

## Visual servo

This is the paper's controller, and the default. It controls the TCP with the image moments of the object.
When a predicted hand comes within the critical distance, an [avoider](../how-to/avoider.md) proposes a
position to retreat to, and a gate decides whether to use it. The controller sees the object and the predicted
hands. It reports its mode, its decisions and its doubt. At the start, the object must be in the camera's
view. The [state table](../reference/controller.md) lists the states and transitions.

## Stop when near

This controller moves straight to the desired TCP position and orientation. It uses only the encoders, and the
settings' `gain_far`. It makes a protective stop while any hand in the sensor's last frame is within the
critical distance of the TCP. It sees the measured joints and hands, and reports its mode. It never retreats
and does not see the object. It watches only the TCP, so a hand at the elbow does not stop it. Its program,
`safety_harness/cell/controller/stop_when_near.py`, has 60 lines.

## Learned policy

This controller is a network of 13,520 weights, `models/learned-policy.onnx`, SHA-256 `{sha256}`.
[examples/train_a_policy.py](../../examples/train_a_policy.py) trained the network by PPO in six minutes on
two processors. The training used the space `reaching-hands`, the random seed 0, and 1.5 million actions of
40 ms each. The network runs in the harness's own process with onnxruntime (extra `onnx`). It sees the TCP,
and the positions and velocities of the predicted hands. It commands the TCP's velocity. It reports no mode
and no decisions, so claims about modes and decisions are inconclusive.

- The reward is 20 for each metre of progress towards the desired position, plus 40 T min(m, 0) at each tick.
  Here m is the margin of "always hand distance > 150 mm" [m], and T = 8 ms. Mean rewards on the samples of
  `reaching-hands` below, with standard errors: {worth}.
- It knows only the desired position, the cell and the speed limits of the default settings.
- It never turns the tool, so a tool that starts tilted stays tilted. It does not see the object, obstacles or
  its own limits.
- It is an example of how to train a policy and collect evidence about it, and must not run on a robot.

## Side by side

The table was measured at revision {revision}, in the kinematic world. All controllers ran on the same
{draws} samples of each space (stream 1000). In each space, the visual servo ran with the space's own avoider.

| column | meaning |
|---|---|
| violated | runs that violate "{near}" |
| limits | runs that violate a speed or joint limit |
| nearest | the least distance of a hand in a run, median over the runs |
| arrived | runs in which the TCP comes within 20 mm of the desired position |
| after | the time until then, median over these runs |
| off | its distance from there at the end, median |

| space | controller | violated | limits | nearest | arrived | after | off |
|---|---|---|---|---|---|---|---|
"""


def properties(scenario: Scenario, sentences: tuple[str, ...]) -> list[Property]:
    """What the sentences claim."""
    return [property_of(Claim(sentence=one, expected=Verdict.HOLDS), scenario) for one in sentences]


def way_m(trace: Trace) -> np.ndarray:
    """(n,) from the TCP to the desired position."""
    desired = np.array(trace.scenario.settings.cell.desired_tcp_position_in_base_m)
    return np.linalg.norm(trace.ticks["transform_tcp_to_base"][:, :3, 3] - desired, axis=1)


def row(space: str, controller: str, traces: Iterator[Trace]) -> tuple[str, list[float]]:
    """How one controller behaves on the draws of one space, and the reward of each run."""
    rewards = []
    near, limits, nearest, off, after, count = 0, 0, [], [], [], 0
    for trace in traces:
        count += 1
        rewards.append(reward(trace))
        found = [one.evaluate(trace).verdict for one in properties(trace.scenario, (NEAR, *KEPT))]
        near += found[0] is Verdict.VIOLATED
        limits += any(verdict is not Verdict.HOLDS for verdict in found[1:])
        distance = np.where(trace.ticks["hand_present"], trace.ticks["hand_distance_m"], np.inf)
        nearest.append(distance.min())
        way = way_m(trace)
        off.append(way[-1])
        within = np.flatnonzero(way <= ARRIVED_M)
        after += [trace.ticks["time_s"][within[0]]] if len(within) else []
    when = f"{np.median(after):.1f} s" if after else ""
    figures = f"{1e3 * np.median(nearest):.0f} mm | {len(after)} | {when} | {1e3 * np.median(off):.0f} mm"
    return f"| {space} | {controller} | {near} of {count} | {limits} | {figures} |", rewards


def traces_of(drawn: list[Scenario], controller: str) -> Iterator[Trace]:
    """Its runs."""
    admitter = Admitter()
    for scenario in drawn:
        one = replace(scenario, claims=())
        if controller != VISUAL_SERVO:
            one = with_avoider(one, Driver(controller))
        yield run_kinematic(admitter.admit(one))


def reward(trace: Trace) -> float:
    """What the learned policy was trained for, of one run."""
    way, ticks = way_m(trace), trace.ticks[1:]
    distance = np.where(ticks["hand_present"], ticks["hand_distance_m"], np.inf).min(axis=1)
    period_s = trace.scenario.settings.clock.control_period_s
    return float(20.0 * (way[0] - way[-1]) + 40.0 * period_s * np.minimum(distance - 0.15, 0.0).sum())


def worth(rewards: dict[str, list[float]]) -> str:
    """Means and standard errors, by controller."""
    each = {name: np.array(own) for name, own in rewards.items()}
    return ", ".join(
        f"{name} {own.mean():.2f} +- {own.std(ddof=1) / np.sqrt(len(own)):.2f}" for name, own in each.items()
    )


def main() -> None:
    """Run them all, and write the page."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--out", type=Path, default=PAGE)
    asked = parser.parse_args()
    rows: list[str] = []
    rewards: dict[str, list[float]] = {}
    for path in sorted((ROOT / "scenarios" / "spaces").glob("*.yaml")):
        drawn = list(draw_admissible(read_space(path), STREAM, asked.draws).scenarios)
        for controller in NAMES:
            shown, own = row(path.stem, controller, traces_of(drawn, controller))
            rows.append(shown)
            if path.stem == TRAINED_IN:
                rewards[controller] = own
            print(shown, flush=True)
    git = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
    head = CARDS.format(
        sha256=hashlib.sha256(LEARNED_FILE.read_bytes()).hexdigest()[:16],
        revision=subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip(),
        draws=asked.draws,
        near=NEAR,
        worth=worth(rewards),
    )
    asked.out.write_text(head + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
