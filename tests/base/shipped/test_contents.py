"""``shipped:NAME`` is a file or folder that comes with the package, wherever a path is taken."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from safety_harness import read_scenario
from safety_harness.admission.avoiders import command_line_reference, is_a_program, with_avoider
from safety_harness.base.exceptions import InputError, Place, ScenarioError
from safety_harness.base.shipped.contents import (
    FOLDERS,
    ShippedFile,
    ShippedKind,
    contents,
    is_installed,
    located,
    shipped_files,
    shipped_name,
)
from safety_harness.scenario.files import display_path

ROOT = Path(__file__).parents[3]
ALL = shipped_files()


def test_a_checkout_ships_its_own_folders() -> None:
    assert contents() == ROOT
    assert not is_installed()


def test_every_name_means_one_file() -> None:
    names = [one.name for one in ALL]
    assert len(set(names)) == len(names)
    assert not {*names} & {*FOLDERS}
    assert {one.kind for one in ALL} == {*ShippedKind}


@pytest.mark.parametrize("one", ALL, ids=[one.name for one in ALL])
def test_everything_shipped_is_found_by_its_name_and_says_what_it_is(one: ShippedFile) -> None:
    assert located(f"shipped:{one.name}") == one.path
    assert shipped_name(one.path) == f"shipped:{one.name}"
    assert one.description.strip()


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("fast-reach", "scenarios/fast-reach.yaml"),
        ("fast-reach.yaml", "scenarios/fast-reach.yaml"),
        ("unseen-both", "scenarios/spaces/unseen-both.yaml"),
        ("scenarios/spaces/unseen-both.yaml", "scenarios/spaces/unseen-both.yaml"),
        ("upwards.py", "examples/upwards.py"),
        ("own_avoider", "examples/suites/own_avoider"),
        ("spaces", "scenarios/spaces"),
        ("examples/suites/own_avoider/visits.yaml", "examples/suites/own_avoider/visits.yaml"),
    ],
)
def test_forms_of_a_name(name: str, file: str) -> None:
    assert located(f"shipped:{name}") == ROOT / file


def test_what_is_not_shipped_stays_as_it_is() -> None:
    assert located("scenarios/fast-reach.yaml") == Path("scenarios/fast-reach.yaml")
    assert shipped_name(ROOT / "README.md") == ""
    assert shipped_name(Path("/etc/passwd")) == ""


def test_a_name_in_a_file_is_no_matter_of_the_file_s_folder() -> None:
    assert located(Path("/somewhere/else") / "shipped:quick") == ROOT / "plans/quick.yaml"


@pytest.mark.parametrize("name", ["", "fast-reech", "../README.md", "examples/../README.md", "Makefile"])
def test_an_unknown_name_is_refused(name: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        located(f"shipped:{name}", Place(field="here"))
    assert caught.value.place == Place(field="here")
    assert "safety-harness list" in caught.value.hint


def test_an_unknown_name_gets_the_three_nearest() -> None:
    with pytest.raises(ScenarioError) as caught:
        located("shipped:hand-visit")
    assert caught.value.hint.count("shipped:") == 3
    assert "shipped:hand-visits-and-leaves" in caught.value.hint


def test_a_mistyped_name_in_a_file_is_told_with_its_line(tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("about: mine\nextends: shipped:fast-reech\n")
    with pytest.raises(InputError) as caught:
        read_scenario(mine)
    assert (caught.value.place.file, caught.value.place.line) == (mine, 2)
    assert "shipped:fast-reach" in caught.value.hint


def test_an_example_is_an_avoider(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    one = with_avoider(read_scenario(Path("shipped:fast-reach")), "shipped:upwards.py:Upwards")
    assert is_a_program(one.avoider)
    file = Path(command_line_reference(one).removesuffix(":Upwards"))
    assert Path(os.path.abspath(file)) == ROOT / "examples/upwards.py"
    with pytest.raises(InputError, match=r"shipped:upwards\.py"):
        with_avoider(one, "shipped:upward.py:Upwards")


def test_results_name_it_so_that_anybody_can_run_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert display_path(Path("shipped:fast-reach")) == Path("shipped:fast-reach")
    assert display_path(ROOT / "scenarios/fast-reach.yaml") == Path("shipped:fast-reach")
    monkeypatch.chdir(ROOT)
    assert display_path(ROOT / "scenarios/fast-reach.yaml") == Path("scenarios/fast-reach.yaml")
