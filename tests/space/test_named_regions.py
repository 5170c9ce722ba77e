"""The seen space is what a network's own file says; data sets and scenarios mean the same by unseen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness.base.exceptions import ModelError, RegionError
from safety_harness.base.geometry.regions import Box
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.model_file import SeenSpace, load_model, save_model
from safety_harness.cell.avoidance.shipped import SHIPPED, shipped_model
from safety_harness.space.distributions import InRegion
from safety_harness.space.read import parse_space
from safety_harness.space.regions import REGIONS, paper_seen, region_named, seen_by

ELSEWHERE = SeenSpace(
    hand_low_m=(0.5, -0.5, -0.3),
    hand_high_m=(1.1, 0.1, 0.3),
    tcp_low_m=(0.6, -0.1, 0.3),
    tcp_high_m=(0.8, 0.1, 0.4),
)
TEXT = """\
scenario space: the network's own unseen space
duration: 5 s
avoider: AVOIDER
tcp start: {offset: {in: unseen tcp}}
claims: {gain switch reached: holds}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a network that has seen something else than ours."""
    save_model(replace(load_model(shipped_model("optimum")), seen=ELSEWHERE), tmp_path / "own.safetensors")
    return tmp_path


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_network_has_seen_what_its_file_says(name: str) -> None:
    seen, model = seen_by(name, folder=None, settings=DEFAULTS), load_model(shipped_model(name))
    assert seen.hand == Box(model.seen.hand_low_m, model.seen.hand_high_m)
    assert seen.tcp == Box(model.seen.tcp_low_m, model.seen.tcp_high_m)
    assert seen.source == name


def test_a_users_network_has_its_own_seen_space(folder: Path) -> None:
    space = parse_space(TEXT.replace("AVOIDER", "own.safetensors"), folder / "space.yaml")
    (parameter,) = space.parameters
    assert isinstance(parameter.distribution, InRegion)
    assert parameter.distribution.known.hole == Box((-0.1, -0.1, -0.05), (0.1, 0.1, 0.05))
    assert parameter.distribution.known.outer == Box((-0.2, -0.2, -0.1), (0.2, 0.2, 0.1))
    assert space.notes == ("the seen space is that of own.safetensors",)


@pytest.mark.parametrize("avoider", ["opposite pose", "nearest candidate", "mine.py:Mine"])
def test_who_does_not_say_what_it_has_seen_has_the_papers_and_the_space_says_so(avoider: str) -> None:
    space = parse_space(TEXT.replace("AVOIDER", avoider))
    assert space.notes == (
        f"the seen space is that of the paper, as {avoider} does not say what it has seen",
    )
    (parameter,) = space.parameters
    assert isinstance(parameter.distribution, InRegion)
    assert parameter.distribution.known.hole == Box((-0.06, -0.15, -0.1), (0.06, 0.15, 0.1))


def test_a_users_program_is_not_run_to_read_a_space(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("raise RuntimeError('it was run')\n")
    parse_space(TEXT.replace("AVOIDER", "mine.py:Mine"), tmp_path / "space.yaml")


def test_a_missing_network_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"none\.safetensors"):
        parse_space(TEXT.replace("AVOIDER", "none.safetensors"), tmp_path / "space.yaml")


def test_no_region_of_hands_reaches_below_the_table() -> None:
    points = region_named("unseen hand", paper_seen(DEFAULTS), DEFAULTS).draw(
        np.random.default_rng(1), 20_000
    )
    assert points[:, 2].min() >= DEFAULTS.cell.table_height_m


def test_there_are_four_regions_and_no_others() -> None:
    assert len({region_named(name, paper_seen(DEFAULTS), DEFAULTS) for name in REGIONS}) == 4
    with pytest.raises(RegionError, match="seen hand, unseen hand, seen tcp, unseen tcp"):
        region_named("unseen both", paper_seen(DEFAULTS), DEFAULTS)
