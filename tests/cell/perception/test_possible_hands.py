"""Where a hand may be: a box that holds so many samples of the filter's own, and the gate's sum."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from safety_harness.admission.admit import admit, check
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.exceptions import InadmissibleError
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.gate import leads_away
from safety_harness.cell.perception.hand_boxes import position_from_box
from safety_harness.cell.perception.hand_filter import filter_parameters
from safety_harness.cell.perception.possible_hands import possible_half_widths_m
from safety_harness.cell.perception.tracking import no_tracks
from safety_harness.report.decisions import possible_lines, refused_for_possible
from safety_harness.scenario.read import parse_scenario
from safety_harness.scenario.write import write_scenario

PARAMETERS = filter_parameters(DEFAULTS.hand_filter, DEFAULTS.hand_sensor)
POSE = np.array([[0.0, -0.8, 0.6, 0.7], [-1.0, 0.0, 0.0, 0.1], [0.0, -0.6, -0.8, 1.5], [0.0, 0.0, 0.0, 1.0]])
AHEAD_S = 0.1


def in_base(box: np.ndarray) -> np.ndarray:
    place = np.empty(3)
    p = PARAMETERS[0]
    position_from_box(box, p["focal_px"], p["c_u"], p["c_v"], p["assumed_radius_m"], place)
    return np.asarray(POSE[:3, :3] @ place + POSE[:3, 3])


def track(u: float, v: float, depth: float) -> np.ndarray:
    """(n,) TRACK with one hand that moves, known to some 3 px and 20 mm, and its speed to 30 px/s."""
    tracks = no_tracks()
    tracks["valid"][0] = True
    tracks["mean"][0] = (u, v, depth, 900.0, 1.0, 40.0, -25.0, 0.3, 0.0)
    tracks["pair_covariance"][0, :3] = [(9.0, 20.0, 900.0), (9.0, -20.0, 900.0), (4e-4, 1e-3, 0.04)]
    return tracks


def samples(tracks: np.ndarray, count: int, seed: int) -> np.ndarray:
    """(count, 3) places at AHEAD_S, drawn from the filter's state and an acceleration, one after another."""
    rng, p, one = np.random.default_rng(seed), PARAMETERS[0], tracks[0]
    found = np.zeros((count, 5))
    for i in range(3):
        value, both, rate = one["pair_covariance"][i]
        drawn = rng.multivariate_normal(
            [one["mean"][i], one["mean"][5 + i]], [[value, both], [both, rate]], count
        )
        push = rng.normal(0.0, np.sqrt(p["acceleration_variance"][i]), count)
        found[:, i] = drawn[:, 0] + AHEAD_S * drawn[:, 1] + 0.5 * AHEAD_S**2 * push
    return np.array([in_base(box) for box in found])


def predicted(tracks: np.ndarray) -> np.ndarray:
    return in_base(np.array([*(tracks["mean"][0, :3] + AHEAD_S * tracks["mean"][0, 5:8]), 0.0, 0.0]))


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.99])
def test_so_many_of_the_filter_s_hands_are_in_the_box(probability: float) -> None:
    tracks = track(500.0, 200.0, 1.2)
    half = possible_half_widths_m(tracks, AHEAD_S, PARAMETERS, POSE, probability)
    assert half.shape == (1, 3)
    inside = (np.abs(samples(tracks, 4000, 1) - predicted(tracks)) <= half).all(axis=1).mean()
    assert inside >= probability - 3.0 * np.sqrt(probability * (1.0 - probability) / 4000)
    assert inside < 0.5 + 0.5 * probability + 0.35  # and it is a box, not the room
    wider = possible_half_widths_m(tracks, AHEAD_S + 0.2, PARAMETERS, POSE, probability)
    assert (wider > half).all()


PLACE = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)


@given(
    way=PLACE, hand=PLACE, half=st.tuples(*[st.floats(0.0, 0.3)] * 3).map(np.array), seed=st.integers(0, 99)
)
def test_the_closed_form_is_the_least_over_the_box(
    way: np.ndarray, hand: np.ndarray, half: np.ndarray, seed: int
) -> None:
    tcp = np.array([0.7, 0.0, 0.35])
    if np.linalg.norm(way) < 1e-3:
        return
    corners = hand + half * np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, 8).T
    inside = hand + half * np.random.default_rng(seed).uniform(-1.0, 1.0, (50, 3))
    least = float(((tcp - corners) @ way).min())
    said = leads_away(tcp, way, hand[None], half[None])
    assert said == (least >= 0.0) or abs(least) < 1e-12
    if said:
        assert ((tcp - inside) @ way >= -1e-12).all()
        nearer = np.linalg.norm(tcp + 0.3 * way - inside, axis=1) < np.linalg.norm(tcp - inside, axis=1)
        assert not nearer.any()
    assert leads_away(tcp, way, hand[None], 0.0 * half[None]) == leads_away(tcp, way, hand[None])


VISIT = """
scenario: a hand comes beside the tool
duration: 3 s
seed: 3
avoider: nearest candidate
tcp start: {offset: [20 mm, -60 mm, 20 mm]}
hand sensor: {kind: overhead, pixel noise: 2 px, rate: 30 Hz}
hands:
  - hand: right hand
    starts at: [1100 mm, -700 mm, 300 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - wait: 300 ms
      - reach for tcp: 1 m/s
        stop at distance: 250 mm
        give up after: 2 s
claims:
  repulsion moves away from every hand: holds
"""


def test_what_is_refused_for_it_is_counted_apart() -> None:
    plain = run_kinematic(admit(parse_scenario(VISIT)))
    ruled = run_kinematic(admit(parse_scenario(VISIT + "gate: {every hand within: 99.99 %}\n")))
    assert possible_lines([plain]) == []
    refused, asked = refused_for_possible(ruled), len(ruled.decisions)
    assert 0 < refused <= asked
    assert possible_lines([plain, ruled]) == [
        f"{refused} of {asked} proposals refused only for where a hand may be"
    ]
    assert refused_for_possible(plain) == 0
    assert ruled.system.gate is not None
    assert ruled.system.gate.name == "full gate, every hand within 99.99 %"


def test_it_is_read_written_and_refused_where_there_is_no_such_gate() -> None:
    read = parse_scenario(VISIT + "gate: {every hand within: 95 %}\n")
    assert parse_scenario(write_scenario(read)).gate == read.gate
    assert parse_scenario(VISIT).gate is None
    for words in ("settings: {avoidance: {gate: reach}}\n",):
        with pytest.raises(InadmissibleError, match=r"gate: expected the visual servo with its full gate"):
            check(parse_scenario(f"{VISIT}gate: {{every hand within: 95 %}}\n{words}"))
