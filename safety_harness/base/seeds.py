"""One explicit seed tree: every random number of a run descends from the scenario's seed.

A leaf is named by a path of integers below the root, so that a stream does not move when
another one is added, and decision k is the same wherever and in whatever order it is made.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Branch(IntEnum):
    """The first step below the root.  Numbers are part of the trace format: never reuse one."""

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


def generator(root: int, branch: Branch, *path: int) -> np.random.Generator:
    """A fresh generator for the stream ``branch/path`` below ``root``."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(root, spawn_key=(branch, *path))))


def seed(root: int, branch: Branch, *path: int) -> int:
    """A 63-bit seed for a consumer that makes its own generator (an avoider, say)."""
    words = np.random.SeedSequence(root, spawn_key=(branch, *path)).generate_state(1, np.uint64)
    return int(words[0] >> np.uint64(1))
