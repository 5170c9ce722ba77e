"""What pyproject.toml asks for: ranges in the package, exact versions in the lock file, extras by name."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

from safety_harness.base import extras
from safety_harness.base.extras import Extra

ROOT = Path(__file__).parents[2]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
BASE = [Requirement(line) for line in PROJECT["dependencies"]]
EXTRAS = {
    name: [Requirement(line) for line in lines] for name, lines in PROJECT["optional-dependencies"].items()
}
LOCKED = {
    canonicalize_name(line.partition("==")[0]): line.partition("==")[2]
    for line in (ROOT / "requirements.lock").read_text().splitlines()
    if not line.startswith("#")
}
# Dependencies that the resolver may choose against ours, each of which once could not be had.
OLDER = {"numpy": "1.26.4", "scipy": "1.16.0", "hypothesis": "6.149.0", "typer": "0.15.4"}


def of_users() -> list[Requirement]:
    """Those of the package and of the extras that its messages name."""
    asked = BASE + [one for extra in named() for one in EXTRAS[extra.name]]
    return [one for one in asked if one.name != PROJECT["name"]]


def named() -> list[Extra]:
    return [value for value in vars(extras).values() if isinstance(value, Extra)]


def test_the_base_is_ten_packages_and_the_reference_world_that_has_a_wheel() -> None:
    conditional = [one for one in BASE if one.marker is not None]
    assert len(BASE) - len(conditional) == 10
    assert [(one.name, str(one.marker)) for one in conditional] == [
        ("pybullet", 'python_version < "3.12"'),
        ("mujoco-core", 'python_version >= "3.12"'),
    ]


@pytest.mark.parametrize("requirement", of_users(), ids=lambda one: one.name)
def test_a_requirement_is_a_range_with_a_lower_end_only(requirement: Requirement) -> None:
    assert [one.operator for one in requirement.specifier] == [">="]


@pytest.mark.parametrize("requirement", of_users(), ids=lambda one: one.name)
def test_the_lock_file_has_a_version_of_the_range(requirement: Requirement) -> None:
    assert LOCKED[canonicalize_name(requirement.name)] in requirement.specifier


@pytest.mark.parametrize("name", OLDER)
def test_an_older_version_that_others_need_is_in_the_range(name: str) -> None:
    (requirement,) = (one for one in BASE if one.name == name)
    assert OLDER[name] in requirement.specifier


@pytest.mark.parametrize("extra", named(), ids=lambda one: one.name)
def test_an_extra_that_a_message_names_can_be_installed(extra: Extra) -> None:
    assert extra.name in EXTRAS


def test_each_range_stands_once_and_an_extra_that_is_named_is_there() -> None:
    """PyBullet is a dependency only where there is a wheel, and an extra elsewhere."""
    asked = [one for lines in EXTRAS.values() for one in lines]
    ranges = [one.name for one in [*BASE, *asked] if one.specifier and not one.marker]
    assert sorted(ranges) == sorted({*ranges})
    assert {extra for one in asked if one.name == PROJECT["name"] for extra in one.extras} <= {*EXTRAS}


def test_classifiers_and_the_check_of_the_wheel_have_every_python_that_is_allowed() -> None:
    allowed = SpecifierSet(PROJECT["requires-python"])
    versions = [f"3.{minor}" for minor in range(30) if f"3.{minor}" in allowed]
    classified = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    (tried,) = re.findall(r"^VERSIONS = \((.*)\)$", (ROOT / ".ci" / "installed.py").read_text(), re.MULTILINE)
    assert versions == classified == re.findall(r"[\d.]+", tried)


def test_the_page_of_an_index_has_no_link_into_the_repository() -> None:
    page = (ROOT / PROJECT["readme"]).read_text()
    assert not [link for link in re.findall(r"\]\(([^)]+)\)", page) if not link.startswith("https://")]
