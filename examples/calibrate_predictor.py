"""The calibration of the predictor in constant_acceleration.py, which prints its radius in four minutes.

python examples/calibrate_predictor.py

It draws runs of the shipped space reaching-hands, but with cameras all around, because the overhead camera
does not see the resting hand. Each run gives one error: at one drawn instant, the distance of a hand from the
nearest prediction, greatest of all hands. A test takes another seed.
"""

import math
import sys
import tempfile
from pathlib import Path

import numpy as np

from safety_harness import admit, draw_admissible, judge, run_kinematic
from safety_harness.space.read import read_space

PREDICTOR = Path(__file__).with_name("constant_acceleration.py")
RUNS, SEED, LEVEL = 199, 2026, 0.95
SPACE = f"""
scenario space: a person reaches for the tool, and cameras all around see it
extends: shipped:reaching-hands
without: [claims]
hand sensor: {{kind: surround}}
predictor: {PREDICTOR}:ConstantAcceleration
claims:
  predicted sets of at most 400 mm hold each hand that has been there for 200 ms, at a drawn instant: holds
"""


def errors_m(runs, seed):
    """Return the errors (runs,) in metres; infinite for a hand without a ball."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "space.yaml")
        file.write_text(SPACE)
        scenarios = draw_admissible(read_space(file), seed, runs).scenarios
    return np.array([error_m(scenario) for scenario in scenarios])


def error_m(scenario):
    """Return the error of one run."""
    trace = run_kinematic(admit(scenario))
    (evaluation,) = judge(trace)
    radius_m = math.sqrt(trace.predicted["shape_m2"].max())  # the same for all balls
    margin = evaluation.margin  # (1 - g)/(1 + g), with the error in radii as g; -1 without a ball
    return math.inf if margin == -1.0 else radius_m * (1.0 - margin) / (1.0 + margin)


def quantile(errors, level):
    """Return the ceil((n + 1) level)-th smallest of n errors; infinite if n is too small for that."""
    rank = math.ceil(round((len(errors) + 1) * level, 9))
    return np.sort(errors)[rank - 1] if rank <= len(errors) else math.inf


if __name__ == "__main__":
    found_m = errors_m(RUNS, SEED)
    sys.stdout.write(f"RADIUS_M = {math.ceil(1e3 * quantile(found_m, LEVEL)) / 1e3}\n")
