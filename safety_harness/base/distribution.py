"""The distribution that installs this package: its name, its version, and a foreign package in its place.

The import name is ``safety_harness`` and the command ``safety-harness``.  The distribution of that name is
another project.  It has a folder ``safety_harness`` too, and pip overwrites our files with it.
"""

from __future__ import annotations

from functools import lru_cache
from importlib import metadata
from pathlib import Path

DISTRIBUTION = "hand-safety-harness"
FOREIGN = "safety-harness"
PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"


@lru_cache
def installed_version() -> str:
    """Return the installed version, or the checkout's where only its sources are on the path."""
    try:
        return metadata.version(DISTRIBUTION)
    except metadata.PackageNotFoundError:
        if not PYPROJECT.is_file():
            raise
        import tomllib  # which an installation does not need

        return str(tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]["version"])


def foreign_files() -> str:
    """Return one line about a distribution ``safety-harness`` with files in our folder; empty without one."""
    try:
        foreign = metadata.distribution(FOREIGN)
    except metadata.PackageNotFoundError:
        return ""
    if "\nsafety_harness/" not in f"\n{foreign.read_text('RECORD') or ''}":  # an editable one has none there
        return ""
    return (
        f"{FOREIGN} {foreign.version}, another project, has files in the folder of {DISTRIBUTION}: "
        f"pip uninstall {FOREIGN} {DISTRIBUTION}, then install {DISTRIBUTION} again"
    )
