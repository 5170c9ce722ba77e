"""Find URDFs in installed packages.

For example, ``pybullet/kuka_iiwa/model`` leads to a file wherever pybullet is installed.
"""

from __future__ import annotations

from functools import lru_cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from safety_harness.base.exceptions import Place, ScenarioError, near_miss

EXTRAS = {"example-robot-data": "arms", "pybullet": "pybullet"}


def urdf_of_package(text: str, place: Place) -> Path:
    """Return the URDF for ``text``, DISTRIBUTION/NAME.

    The distribution must have exactly one URDF whose path ends with NAME.

    Args:
        text: DISTRIBUTION/NAME, where NAME needs no suffix ``.urdf`` and has enough folders to be unique.
        place: The place of the text, for errors.

    Raises:
        ScenarioError: The distribution is not installed, or NAME does not match exactly one URDF.

    """
    name, _, end = text.removesuffix(".urdf").partition("/")
    if not (name and end):
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
    fits = [path for path in urdfs if f"/{path}".endswith(f"/{end}")]
    if len(fits) != 1:
        known = sorted(path.partition("/")[2] for path in urdfs)
        expected, got = f"the name of one of {name}'s {len(known)} URDFs", f"{end!r}, which {len(fits)} have"
        raise ScenarioError(place=place, expected=expected, got=got, hint=near_miss(end, known, most=3))
    return urdfs[fits[0]]


@lru_cache
def _urdfs_of(distribution_name: str) -> dict[str, Path]:
    """Return a distribution's URDF files, with their paths without ``.urdf`` as keys.

    Raise PackageNotFoundError if the distribution is not installed.
    """
    files = distribution(distribution_name).files or ()
    urdfs = [file for file in files if file.suffix == ".urdf"]
    return {file.as_posix().removesuffix(".urdf"): Path(str(file.locate())).resolve() for file in urdfs}
