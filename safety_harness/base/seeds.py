"""The seed tree: every random number of a run is derived from the scenario's seed.

A stream of random numbers is identified by a path of integers below the root.  Therefore a stream does not
change when another stream is added.  Decision k always gets the same random numbers, in every process and in
every order.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Branch(IntEnum):
    """The first number of a path below the root.  Each number belongs to the trace format: never reuse it."""

    HAND_SENSOR_NOISE = 1
    DECISION = 2
    SPACE_DRAW = 3
    HAND_MOTION = 4
    SEARCH = 5
    CAMPAIGN = 6
    STATISTICS = 7
    SELFTEST = 8
    DECISION_TIME = 9
    SCORING = 10
    CONTROLLER = 11
    ENVIRONMENT = 12
    PROOF = 13
    SAFETY_FILTER = 14
    PREDICTOR = 15
    PREDICTED_INSTANT = 16


def generator(root: int, branch: Branch, *path: int) -> np.random.Generator:
    """Return a fresh generator for the stream ``branch/path`` below ``root``."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(root, spawn_key=(branch, *path))))


def seed(root: int, branch: Branch, *path: int) -> int:
    """Return a 63-bit seed for an object that has its own generator, such as an avoider."""
    state = np.random.SeedSequence(root, spawn_key=(branch, *path)).generate_state(1, np.uint64)
    return int(state[0] >> np.uint64(1))
