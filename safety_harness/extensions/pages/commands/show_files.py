"""Draw the scenarios of files."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Checker
from safety_harness.admission.preview import preview_of
from safety_harness.admission.spaces import draw_admissible
from safety_harness.base.exceptions import ScenarioError
from safety_harness.base.whole_file import writing
from safety_harness.cli.console import AS_EXPECTED, document, next_step, result, say
from safety_harness.extensions.pages.scene import Boxes, draw_scene
from safety_harness.scenario.expand import gather
from safety_harness.scenario.model import Scenario
from safety_harness.space.distributions import InBox, InRegion
from safety_harness.space.read import space_of
from safety_harness.space.space import ScenarioSpace

PICTURE = ".svg"


def show(files: Sequence[Path], *, out: Path, draws: int, seed: int) -> int:
    """Draw one picture per scenario, and one picture per space with several of its draws.

    Return the exit code.

    Args:
        files: scenario files, spaces, suites or folders.
        out: the folder for the pictures, or an SVG file for a single picture.
        draws: the number of admissible draws of each space.
        seed: the seed of the draws.

    Raises:
        InputError: a file or an option is not valid.

    """
    gathered = gather(files, spaces=True)
    if gathered.errors:
        raise gathered.errors[0]
    if out.suffix in (".png", ".pdf"):
        raise ScenarioError.of_option("--out", "a folder, or a file.svg", str(out))
    alone = out.suffix == PICTURE and len(gathered.scenarios) + len(gathered.spaces) == 1
    pictures = []
    for scenario in gathered.scenarios:
        path = out if alone else out / f"{scenario.name}{PICTURE}"
        pictures.append(_draw(path, [scenario], scenario.title))
    for variant, file in gathered.spaces:
        space = space_of(variant.tree, file, name=variant.name)
        drawn = draw_admissible(space, seed, draws)
        say(f"{file}: {drawn}")
        path = out if alone else out / f"{space.name}{PICTURE}"
        pictures.append(_draw(path, drawn.scenarios, space.title, regions_of(space)))
    document(pictures=pictures)
    spaces = [str(file) for _, file in gathered.spaces]
    next_step(shlex.join(["safety-harness", *(("fuzz", spaces[0]) if spaces else ("run", *map(str, files)))]))
    return AS_EXPECTED


def _draw(path: Path, scenarios: Sequence[Scenario], title: str, regions: Boxes = ()) -> Path:
    checker = Checker()
    previews = [preview_of(checker.check(scenario)) for scenario in scenarios]
    with writing(path):
        draw_scene(path, previews, title=title, regions=regions)
    result(str(path))
    return path


def regions_of(space: ScenarioSpace) -> list[tuple[str, NDArray[np.float64], NDArray[np.float64]]]:
    """Return the name, the low corner and the high corner [m, base frame] of each box of a space."""
    corners: dict[tuple[object, ...], tuple[str, NDArray[np.float64], NDArray[np.float64]]] = {}
    desired = np.array(space.simplest.settings.cell.desired_tcp_position_in_base_m)
    for parameter in space.parameters:
        distribution = parameter.distribution
        shift = desired if ".offset" in parameter.name else np.zeros(3)
        boxes = []
        if isinstance(distribution, InRegion):
            region = distribution.known
            boxes = [(distribution.name, region.outer.low_m, region.outer.high_m)]
            if region.hole is not None:
                boxes.append(("seen", region.hole.low_m, region.hole.high_m))
        elif isinstance(distribution, InBox):
            boxes = [(parameter.name, distribution.low, distribution.high)]
        for name, low, high in boxes:
            corners[(name, *low, *high)] = (name, np.array(low) + shift, np.array(high) + shift)
    return list(corners.values())
