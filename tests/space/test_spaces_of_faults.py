"""Faults and robots may vary like anything else: every draw comes back from its scenario."""

from __future__ import annotations

import numpy as np

from safety_harness.scenario.faults import CameraFrozen, FalseHand, JointStuck
from safety_harness.scenario.robots import Robot
from safety_harness.space.read import parse_space

SPACE = """\
scenario space: faults
duration: 5 s
robot: one of UR10, UR5
tcp start: {offset: [0 mm, 0 mm, 0 mm]}
choices:
  when: from 0 s to 2 s
faults:
  - hand sensor: is late
    delay: from 1 ms to 200 ms
    from: the when
    for: from 100 ms to 1 s
  - one of:
      - camera: freezes
        from: from 0 s to 1 s
      - joint: is stuck
        which: one of elbow, wrist 1
        until: from 3 s to 4 s
      - hand sensor: sees a false hand
        at: {box: [[700 mm, -300 mm, 0 mm], [800 mm, -200 mm, 100 mm]]}
claims: {gain switch reached: holds}
"""


def test_every_draw_is_brought_back_with_its_faults_and_its_robot() -> None:
    space = parse_space(SPACE)
    rng = np.random.default_rng(1)
    robots, kinds = set(), set()
    for u in [np.zeros(space.dimension), np.ones(space.dimension), *rng.random((60, space.dimension))]:
        drawn = space.at(u)
        again = space.at(space.cube_of(drawn))
        assert (again.faults, again.robot) == (drawn.faults, drawn.robot)
        robots.add(drawn.robot)
        kinds.add(type(drawn.faults[1]))
    assert robots == {Robot.UR10, Robot.UR5}
    assert kinds == {CameraFrozen, JointStuck, FalseHand}
