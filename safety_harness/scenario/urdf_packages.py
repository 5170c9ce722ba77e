"""URDFs that installed packages bring: ``pybullet/kuka_iiwa/model`` is a file, wherever that is installed."""

from __future__ import annotations

from functools import lru_cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from safety_harness.base.exceptions import Place, ScenarioError, near_miss

EXTRAS = {"example-robot-data": "arms", "pybullet": "pybullet"}


def urdf_of_package(text: str, place: Place) -> Path:
    """The file that DISTRIBUTION/NAME names: the one URDF of the distribution whose path ends with NAME.

    NAME is without ``.urdf`` and has as many folders as tell it from others.  ScenarioError, at ``place``,
    for a distribution that is not installed, no such URDF, or several.
    """
    name, _, way = text.removesuffix(".urdf").partition("/")
    if not (name and way):
        expected = "DISTRIBUTION/NAME, as pybullet/kuka_iiwa/model"
        raise ScenarioError(place=place, expected=expected, got=repr(text))
    try:
        urdfs = _urdfs_of(name)
    except PackageNotFoundError:
        expected = "an installed package, before the first /"
        extra = EXTRAS.get(name)
        hint = f"the extra {extra} installs it" if extra else ""
        got = f"{name!r}, which is not installed"
        raise ScenarioError(place=place, expected=expected, got=got, hint=hint) from None
    found = [path for path in urdfs if f"/{path}".endswith(f"/{way}")]
    if len(found) != 1:
        known = sorted(path.partition("/")[2] for path in urdfs)
        expected, got = f"the name of one of {name}'s {len(known)} URDFs", f"{way!r}, which {len(found)} have"
        raise ScenarioError(place=place, expected=expected, got=got, hint=near_miss(way, known, most=3))
    return urdfs[found[0]]


@lru_cache
def _urdfs_of(distribution_name: str) -> dict[str, Path]:
    """The files by their paths in the distribution, without ``.urdf``; PackageNotFoundError."""
    files = distribution(distribution_name).files or ()
    urdfs = [file for file in files if file.suffix == ".urdf"]
    return {file.as_posix().removesuffix(".urdf"): Path(str(file.locate())).resolve() for file in urdfs}
