"""Margins over the unit cube that are negative with a known chance: rare events in standard normal space."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from safety_harness.extensions.assurance.statistics.rare import Margins
from safety_harness.extensions.assurance.statistics.sample import Floats


def normal(points: Floats) -> Floats:
    return np.asarray(ndtri(np.maximum(points, 1e-300)))


def tail(sigma: float) -> Margins:
    return lambda points: sigma - normal(points)[:, 0]


def two_tails(sigma: float) -> Margins:
    return lambda points: sigma - np.abs(normal(points)[:, 0])


def outside_a_sphere(radius: float) -> Margins:
    return lambda points: radius - np.linalg.norm(normal(points), axis=1)
