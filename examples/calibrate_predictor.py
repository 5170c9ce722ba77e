"""The calibration of the predictor in constant_acceleration.py, which prints its radius in four minutes.

python examples/calibrate_predictor.py
python examples/calibrate_predictor.py --recordings anna=a.csv,b.csv ben=c.csv ...
python examples/calibrate_predictor.py --recordings FOLDER     (with a folder of recordings for each person)

Without recordings it draws runs of the shipped space reaching-hands, but with cameras all around, because the
overhead camera does not see the resting hand. Each run gives one error: at one drawn instant, the distance of
a hand from the nearest prediction, greatest of all hands. A test takes another seed.

Recordings of one person depend on each other. So each person gives one number, the largest error of the
person's recordings, and nobody is in both the calibration and the test.
"""

import argparse
import itertools
import math
import sys
import tempfile
from pathlib import Path

import numpy as np

from safety_harness import admit, draw_admissible, judge, run_kinematic
from safety_harness.scenario.read import parse_scenario
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
RECORDED = """
scenario: a recorded person
duration: {duration_s} s
seed: {seed}
tcp start: {{offset: [20 mm, -60 mm, 40 mm]}}
avoider: opposite pose
hand sensor: {{kind: surround}}
predictor: {predictor}:ConstantAcceleration
hands:
  - recording: {file}
    track: right hand
    starts at: [1130 mm, -1680 mm, {height_m:.3f} m]
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


def rank(count, level):
    """Return ceil((count + 1) level), the rank of the quantile among ``count`` errors."""
    return math.ceil(round((count + 1) * level, 9))


def quantile(errors, level):
    """Return the ceil((n + 1) level)-th smallest of n errors; infinite if n is too small for that."""
    number = rank(len(errors), level)
    return np.sort(errors)[number - 1] if number <= len(errors) else math.inf


def least_people(level):
    """Return the least number of people whose errors have a finite quantile."""
    return next(count for count in itertools.count(1) if rank(count, level) <= count)


def people_of(words):
    """Return the recordings of each person, from words NAME=FILE,FILE or folders of people's folders."""
    people = {}
    for word in words:
        name, equals, files = word.partition("=")
        if equals:
            found = {name: [Path(file) for file in files.split(",")]}
        else:
            found = {
                one.name: sorted(one.glob("*.csv")) for one in sorted(Path(word).iterdir()) if one.is_dir()
            }
        if twice := people.keys() & found.keys():
            raise ValueError(f"{min(twice)} is named twice")
        people |= found
    for name, files in people.items():
        if not files or not all(file.is_file() for file in files):
            raise ValueError(f"{name} has no recording, or one that is no file")
    every = [file.resolve() for files in people.values() for file in files]
    if len({*every}) < len(every):
        raise ValueError("a recording belongs to two people, or twice to one")
    return people


def split(names, level, seed):
    """Return the people for the calibration and those for the test, drawn by the seed; no one is in both.

    The calibration gets as many as the level needs, and half of the others.
    """
    least = least_people(level)
    if len(names) <= least:
        needs = f"{100 * level:g} % needs {least + 1} people, {least} for the calibration and 1 for the test"
        raise ValueError(f"{needs}; there are {len(names)}")
    drawn = np.random.default_rng(seed).permutation(sorted(names)).tolist()
    count = least + (len(names) - least) // 2
    return drawn[:count], drawn[count:]


def person_error_m(files, seeds):
    """Return the largest error of a person's recordings, each at an instant drawn by its seed."""
    return max(error_m(recorded(file, seed)) for file, seed in zip(files, seeds, strict=True))


def recorded(file, seed):
    """Return the scenario of a recording, whose right hand is 100 mm above the arm's base at its lowest."""
    table = np.genfromtxt(file, delimiter=",", names=True)
    times_s, heights_m = table["time_s"], table["right_hand_z_m"]
    text = RECORDED.format(
        file=file.resolve(),
        seed=seed,
        duration_s=math.floor(times_s[-1] - times_s[0]),
        height_m=0.1 + heights_m[0] - np.nanmin(heights_m),
        predictor=PREDICTOR,
    )
    return parse_scenario(text)


def calibrate_on(people, level):
    """Return the radius in metres, and the errors of the people in the test."""
    calibration, test = split(people, level, SEED)
    seeds = np.random.default_rng(SEED).integers(2**31, size=sum(map(len, people.values()))).tolist()
    found_m = {
        name: person_error_m(files, [seeds.pop() for _ in files]) for name, files in sorted(people.items())
    }
    radius_m = quantile([found_m[name] for name in calibration], level)
    return radius_m, [found_m[name] for name in test]


def rounded_up(radius_m):
    """Return the radius, rounded up to a millimetre."""
    return math.ceil(1e3 * radius_m) / 1e3 if math.isfinite(radius_m) else radius_m


def main():
    """Calibrate as the command line says, and print the radius."""
    parser = argparse.ArgumentParser(description="Calibrate the radius of constant_acceleration.py.")
    parser.add_argument("--recordings", nargs="+", metavar="NAME=FILE,FILE", help="or a folder of people")
    parser.add_argument(
        "--level", type=float, default=LEVEL, help="the probability that a ball holds the hand"
    )
    given = parser.parse_args()
    if not given.recordings:
        radius_m, test_m = quantile(errors_m(RUNS, SEED), given.level), []
    else:
        try:
            radius_m, test_m = calibrate_on(people_of(given.recordings), given.level)
        except (ValueError, OSError) as error:
            sys.exit(f"error: {error}")
    sys.stdout.write(f"RADIUS_M = {rounded_up(radius_m)}\n")
    if test_m:
        held = sum(one_m <= rounded_up(radius_m) for one_m in test_m)
        sys.stdout.write(f"of {len(test_m)} other people, {held} have all errors within the radius\n")


if __name__ == "__main__":
    main()
