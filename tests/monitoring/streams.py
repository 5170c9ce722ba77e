"""A simulated run as somebody's cell would give it: hands that were recorded, and a stream of samples."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.monitoring.sample import GIVEN, HandSample, Sample, line_of
from safety_harness.scenario.model import RecordedHand, RecordedMotion
from safety_harness.scenario.read import parse_scenario
from safety_harness.trace.records import Mode
from safety_harness.trace.trace import Trace

VISIT = """\
scenario: a hand passes
duration: 1.6 s
tcp start: {offset: [40 mm, -120 mm, 60 mm]}
avoider: opposite pose
hands:
  - hand: right
    starts at: [900 mm, -500 mm, 200 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - move to: [760 mm, -200 mm, 420 mm]
        speed: 1.5 m/s
      - withdraw: 1 m/s
  - hand: left
    starts at: [1000 mm, 500 mm, 200 mm]
    elbow towards: [1600 mm, 1200 mm, 300 mm]
    moves: [{wait: 300 ms}, {move to: [900 mm, 300 mm, 250 mm], speed: 1 m/s}]
claims: {joint speeds within limits: holds}
"""


@lru_cache
def recorded() -> Trace:
    """The run, of which the hands are recordings with a sample at every tick."""
    trace = run_kinematic(admit(parse_scenario(VISIT)))
    ticks, scenario = trace.ticks, trace.scenario
    hands = tuple(
        RecordedHand(
            recording=None,  # type: ignore[arg-type]  # of a motion that no file has
            motion=RecordedMotion(
                time_s=ticks["time_s"].copy(),
                hand_position_in_base_m=ticks["hand_position_in_base_m"][:, k].copy(),
                elbow_position_in_base_m=ticks["elbow_position_in_base_m"][:, k].copy(),
                notes=(),
                sha256="",
            ),
            name=hand.name,
            track=hand.name,
            starts_at_in_base_m=tuple(ticks["hand_position_in_base_m"][0, k]),
        )
        for k, hand in enumerate(scenario.hands)
    )
    return replace(trace, scenario=replace(scenario, hands=hands))


def until(trace: Trace, ticks: int) -> Trace:
    """The first ``ticks`` of it, as a whole run."""
    period_s = trace.scenario.settings.clock.control_period_s
    shorter = replace(trace.scenario, duration_s=(ticks - 1) * period_s)
    kept = trace.decisions["tick"] < ticks
    return replace(
        trace,
        scenario=shorter,
        ticks=trace.ticks[:ticks].copy(),
        decisions=trace.decisions[kept].copy(),
        decision_latency_s=trace.decision_latency_s[kept].copy(),
    )


def samples(trace: Trace) -> Iterator[Sample]:
    """One a tick, with everything that a stream can have of it."""
    for tick in trace.ticks:
        mode = Mode(tick["mode"])
        signals = {
            "servoing": mode is Mode.SERVOING,
            "repulsing": mode is Mode.REPULSING,
            "stopped": mode is Mode.PROTECTIVE_STOP,
            "object lost": mode is Mode.OBJECT_LOST,
            "object visible": bool(tick["object_visible"]),
            "deciding": tick["decision"] >= 0,
            "hand tracked": bool(tick["track_valid"].any()),
        }
        if np.isfinite(tick["sse"]):
            signals["image error"] = float(tick["sse"])
        assert signals.keys() <= GIVEN.keys()
        yield Sample(
            time_s=float(tick["time_s"]),
            joint_position_rad=tuple(tick["joint_position_rad"].tolist()),
            joint_velocity_radps=tuple(tick["joint_velocity_radps"].tolist()),
            hands={
                hand.name: HandSample(
                    tuple(tick["hand_position_in_base_m"][k].tolist()),
                    tuple(tick["elbow_position_in_base_m"][k].tolist()),
                )
                for k, hand in enumerate(trace.scenario.hands)
            },
            signals={words: value if words == "image error" else bool(value) for words, value in signals.items()},
        )


def lines(trace: Trace) -> list[bytes]:
    """The same as lines."""
    return [line_of(sample) for sample in samples(trace)]
