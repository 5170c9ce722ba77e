"""How long do 100,000 scenarios of each shipped space take to unit-cube vectors and back?

Run: python benchmarks/spaces.py.  Twice: as arrays of values, all at once, and as whole Scenario objects,
each made of its values and found again in the space (which makes it once more to be sure).
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import time
from pathlib import Path

import numpy as np

from safety_harness.space.read import read_space
from safety_harness.space.space import ScenarioSpace

FOLDER = Path(__file__).parents[1] / "scenarios/spaces"
SCENARIOS = 100_000
AS_OBJECTS = 1_000  # measured; the time of SCENARIOS is in proportion
SEED = 1


def as_arrays(space: ScenarioSpace) -> tuple[float, float]:
    """Seconds from SCENARIOS points of the cube to values and back, and the largest difference."""
    u = np.random.default_rng(SEED).random((SCENARIOS, space.dimension))
    values = space.values_at(u)
    begin_s = time.perf_counter()
    again = space.values_at(space.cube_at(values))
    elapsed_s = time.perf_counter() - begin_s
    assert np.array_equal(np.isnan(again), np.isnan(values))
    return elapsed_s, float(np.nanmax(np.abs(again - values)))


def as_objects(space: ScenarioSpace) -> tuple[float, float, float]:
    """Seconds per scenario to draw, to its unit-cube vector, and from there to a scenario again."""
    begin_s = time.perf_counter()
    drawn = list(space.draws(SEED, AS_OBJECTS))
    drawn_s = time.perf_counter()
    points = [space.cube_of(scenario) for scenario in drawn]
    found_s = time.perf_counter()
    again = [space.at(u, seed=s.seed, name=s.name) for u, s in zip(points, drawn, strict=True)]
    end_s = time.perf_counter()
    for one, other in zip(again[::20], drawn[::20], strict=True):
        assert np.allclose(space.values_of(one), space.values_of(other), rtol=0, atol=1e-12, equal_nan=True)
    steps = (drawn_s - begin_s, found_s - drawn_s, end_s - found_s)
    a, b, c = (step / AS_OBJECTS for step in steps)
    return a, b, c


def main() -> None:
    """Print a line for each space."""
    print(f"{SCENARIOS:,} scenarios of each space to unit-cube vectors and back")
    print(
        "arrays: values -> cube -> values.  objects: Scenario -> cube -> Scenario, per scenario, and in all"
    )
    heads = "".join(f" {head:>8}" for head in ("arrays", "error", "draw", "to cube", "back", "in all"))
    print(f"{'space':<20} {'d':>3}{heads}")
    for file in sorted(FOLDER.glob("*.yaml")):
        space = read_space(file)
        arrays_s, error = as_arrays(space)
        draw_s, cube_s, back_s = as_objects(space)
        print(
            f"{space.name:<20} {space.dimension:>3} {arrays_s:>6.2f} s {error:>8.0e} {draw_s * 1e3:>5.2f} ms "
            f"{cube_s * 1e3:>5.2f} ms {back_s * 1e3:>5.2f} ms {SCENARIOS * (cube_s + back_s):>6.0f} s"
        )


if __name__ == "__main__":
    main()
