"""Every way in which a hand moves, and the object, may have distributions in it."""

from __future__ import annotations

import numpy as np

from safety_harness.scenario.model import JoinedHand, MovingHand
from safety_harness.scenario.moves import Sweep, Wander
from safety_harness.space.read import parse_space

TEXT = """\
scenario space: hands of all kinds
duration: 5 s
tcp start: {position: [700 mm, from -100 mm to 100 mm, 350 mm]}
object:
  yaw: from 10 deg to 40 deg
  position: [from 690 mm to 710 mm, 45 mm, -300 mm]
hands:
  - hand: right
    starts at: [1.1 m, -0.75 m, 200 mm]
    shifted by: {shell: [0 mm, 0 mm, 0 mm], from: 0 mm, to: 50 mm}
    delayed by: from 0 s to 1 s
    speed at most: 2.5 m/s
    acceleration at most: from 5 m/s2 to 12 m/s2
    tremor: {amplitude: from 0.1 mm to 3 mm, rate: from 6 Hz to 12 Hz}
    elbow towards: [1.6 m, -1.2 m, 300 mm]
    moves:
      - wander: from 0.2 m/s to 2 m/s
        within: [[0.9 m, -0.6 m, 0 mm], [from 1.0 m to 1.1 m, -0.4 m, 200 mm]]
        for: from 1 s to 2 s
      - reach for tcp: 1 m/s
        stop at distance: 100 mm
        give up after: 2 s
        hesitating at: from 200 mm to 400 mm
        for: from 100 ms to 500 ms
      - reach for object: from 0.5 m/s to 1 m/s
        stop at distance: 100 mm
        give up after: 2 s
      - sweep: 1 m/s
        from: [0.9 m, -0.3 m, 50 mm]
        to: [0.9 m, from -0.7 m to -0.5 m, 50 mm]
        times: one of 1, 2, 3
  - hand: left
    together with: right
    apart: [0 mm, from 200 mm to 400 mm, 0 mm]
    elbow towards: [1.6 m, 0.8 m, 300 mm]
claims: {gain switch reached: holds}
"""


def test_each_of_them_is_drawn_and_brought_back() -> None:
    space = parse_space(TEXT)
    rng = np.random.default_rng(3)
    for u in rng.random((20, space.dimension)):
        drawn = space.at(u)
        right, left = drawn.hands
        assert isinstance(right, MovingHand)
        assert isinstance(left, JoinedHand)
        wander, _, _, sweep = right.moves
        assert isinstance(wander, Wander)
        assert isinstance(sweep, Sweep)
        assert sweep.times in (1, 2, 3)
        assert 1.0 <= wander.corners_in_base_m[1][0] <= 1.1
        assert np.linalg.norm(right.shift_in_base_m) <= 0.05 + 1e-12
        assert drawn in space
        values = space.values_of(drawn)
        again = space.scenario(values)
        assert (again.hands, again.settings, again.start) == (drawn.hands, drawn.settings, drawn.start)
        assert np.allclose(space.values_at(space.cube_of(drawn)[None])[0], values, rtol=1e-9, atol=1e-12)


def test_a_wander_is_another_one_for_another_seed() -> None:
    space = parse_space(TEXT)
    first, second = space.draw(5, 0), space.draw(5, 1)
    assert first != second
    assert first == space.draw(5, 0)
