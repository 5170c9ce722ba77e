"""Define ``safety-harness sample``, which writes random scenarios of a space."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from safety_harness.admission.avoiders import as_seen_from
from safety_harness.admission.spaces import draw_admissible
from safety_harness.base.exceptions import ScenarioError
from safety_harness.base.whole_file import write_text
from safety_harness.cli.console import AS_EXPECTED, document, result, say
from safety_harness.scenario.write import write_scenario
from safety_harness.space.read import read_space
from safety_harness.space.space import each_to_hold


def sample(file: Path, *, out: Path, count: int, seed: int) -> int:
    """Write admissible draws of a space as scenario files, and return the exit code.

    Args:
        file: the space.
        out: the folder of the files.
        count: the number of draws, 1 to 100,000.
        seed: the seed of the draws.

    Raises:
        ScenarioError: the count is out of range.

    """
    if not 1 <= count <= 100_000:
        raise ScenarioError.of_option("--count", "a number from 1 to 100000", str(count))
    space = read_space(file)
    drawn = draw_admissible(space, seed, count)
    files = []
    for scenario in drawn.scenarios:
        path = out / f"{scenario.name.replace('#', '-')}.yaml"
        stored = replace(scenario, claims=each_to_hold(scenario.claims))
        write_text(path, write_scenario(as_seen_from(out, stored)))
        result(str(path))
        files.append(path)
    document(files=files, drawn=drawn.drawn, refused=drawn.refused)
    say(*space.notes, str(drawn))
    return AS_EXPECTED
