"""The LOG.yaml beside a run's MCAP file: what its streams are, and how well they say what happened."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from safety_harness.admission.avoiders import as_seen_from
from safety_harness.properties.true_motion import finer_paths, true_motion
from safety_harness.report.mcap import NS, hand_samples, joined
from safety_harness.robot.robots import arm_model
from safety_harness.scenario.codec import Tree
from safety_harness.scenario.units import (
    ANGLE,
    ANGULAR_ACCELERATION,
    ANGULAR_SPEED,
    LENGTH,
    SPEED,
    TIME,
    format_quantity,
)
from safety_harness.scenario.write import text_of, tree_of
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import decided, measured

AT_REST = {"repeats": "at rest"}
FILTER = "hand filter"
EXACT = format_quantity(0.0, TIME)
GAPS = 2.5  # periods: what comes every period is not missing for so long
ROUNDED = 1.0 + 1e-9


def log_text(trace: Trace, path: Path) -> str:
    """What LOG.yaml says of the MCAP file ``path`` of a trace, in its folder."""
    scenario = as_seen_from(path.parent, trace.scenario)
    tree, file = tree_of(scenario), path.name
    period_s = scenario.settings.clock.control_period_s
    gap = format_quantity(GAPS * period_s, TIME)
    log: dict[str, Tree] = {"joints": f"{file}#/joint_states"}
    said: dict[str, Tree] = {"log": log, "title": tree["scenario"]}
    said |= {key: tree[key] for key in ("about", "robot", "obstacles", "camera") if key in tree}
    said["joints"] = _joints(trace, gap)
    numbers = range(1, len(scenario.hands) + 1)
    if numbers:
        names = [hand.name for hand in scenario.hands]
        log["hands"] = {name: f"{file}#/hand_{k}" for name, k in zip(names, numbers, strict=True)}
        said["clock"] = {"hands are ahead by": EXACT, "known to": EXACT}
        elbows: dict[str, Tree] = {n: f"{file}#/elbow_{k}" for n, k in zip(names, numbers, strict=True)}
        said["hands"] = {"forearm": elbows, **_hands(trace, gap)}
    log["period"] = format_quantity(period_s, TIME)
    _controller(trace, file, log, said)
    settings = dict(tree.get("settings", {}))  # type: ignore[call-overload]
    settings.pop("clock", None)
    said |= {"settings": settings} if settings else {}
    return text_of(said | {"claims": tree["claims"]})


def _joints(trace: Trace, gap: str) -> dict[str, Tree]:
    """Within a tick a speed may change at any moment, so twice the change per period bounds what it does."""
    true, period_s = true_motion(trace), trace.scenario.settings.clock.control_period_s
    mean_radps = np.diff(true.joints_rad, axis=0) / period_s
    told_radps = np.diff(true.rates_radps, axis=0), np.diff(mean_radps, axis=0)
    beyond_radps = float(trace.overshoot_radps.max(initial=0.0))
    change_radps = max(float(np.abs(one).max(initial=0.0)) for one in told_radps) + 2.0 * beyond_radps
    fastest_radps = max(float(np.abs(one).max(initial=0.0)) for one in (mean_radps, true.rates_radps))
    most_radps = max(fastest_radps + beyond_radps, float(arm_model(trace.scenario.robot).velocity_limit_radps.max()))
    return {
        "known to": format_quantity(1e-9, ANGLE),
        "move at most": format_quantity(most_radps * ROUNDED, ANGULAR_SPEED),
        "accelerate at most": format_quantity(max(2.0 * change_radps / period_s, 1e-6), ANGULAR_ACCELERATION),
        "longest gap": gap,
        **AT_REST,
    }


def _hands(trace: Trace, gap: str) -> dict[str, Tree]:
    """A body is no faster than from sample to sample, and by no more than its speed changes there."""
    paths, fastest_mps = finer_paths(trace), 1e-3
    for hand in range(len(trace.scenario.hands)):
        stamps, places_m = hand_samples(trace, paths, hand)
        velocity_mps = np.diff(places_m, axis=0) / (np.diff(stamps) / NS)[:, None, None]
        changes = np.linalg.norm(np.diff(velocity_mps, axis=0), axis=2)
        speeds = np.linalg.norm(velocity_mps, axis=2)
        fastest_mps = max(fastest_mps, float(speeds.max(initial=0.0) + changes.max(initial=0.0)))
    return {
        "frame": "base",
        "longest gap": gap,
        "moves at most": format_quantity(fastest_mps * ROUNDED, SPEED),
        "known to": format_quantity(1e-6, LENGTH),
        **AT_REST,
    }


def _controller(trace: Trace, file: str, log: dict[str, Tree], said: dict[str, Tree]) -> None:
    """Map those streams of the controller that the run has."""
    stands: dict[str, Tree] = {"known to": EXACT, "longest gap": "until the next"}
    ticks = trace.ticks
    if measured(trace, "mode").all():
        modes = ("servoing", "repulsing", "object lost")
        words: dict[str, Tree] = {word.replace(" ", "_"): word for word in modes}
        log["mode"] = f"{file}#/state:mode"
        said["mode"] = {"words": words | {"protective_stop": "stopped"}, **stands}
    if measured(trace, "limits").all():
        told = [joined(int(flags)) for flags in np.unique(ticks["limits"])]
        log["limits"] = f"{file}#/state:limits"
        said["limits"] = {"words": {word: word for word in told}, **stands}
    if measured(trace, "demanded_joint_velocity_radps").all():
        log["commands"], said["commands"] = f"{file}#/commands", stands
    if measured(trace, "predicted_hand_in_base_m").all():
        tracks = range(1, ticks["track_valid"].shape[1] + 1)
        log["detections"] = {f"track {k}": f"{file}#/tracked_{k}" for k in tracks}
        ahead = format_quantity(trace.scenario.settings.hand_filter.prediction_horizon_s, TIME)
        said["detections"] = {"frame": "base", "ahead by": ahead, **stands}
    at_once = (trace.decisions["asked_tick"] == trace.decisions["tick"]).all()
    if decided(trace) and at_once and len(trace.decisions):
        names = ("hand", "tcp", "proposed", "chosen", "opposite", "spread", "threshold", "outcome", "trigger")
        log["decisions"] = f"{file}#/decisions"
        said["decisions"] = {"known to": EXACT, "frame": "base", "fields": {name: name for name in names}}
