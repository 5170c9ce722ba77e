"""The distribution that installs this package: its name, its version, and conflicts with another project.

The import name is ``safety_harness`` and the command is ``safety-harness``.  But the distribution named
``safety-harness`` is another project.  It also has a folder ``safety_harness``, with which pip overwrites our
files.
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
    """Return the installed version, or the checkout's version if nothing is installed."""
    try:
        return metadata.version(DISTRIBUTION)
    except metadata.PackageNotFoundError:
        if not PYPROJECT.is_file():
            raise
        import tomllib  # an installation does not need it

        return str(tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]["version"])


def foreign_files() -> str:
    """Return a line of advice if the foreign distribution has files in our folder, else an empty text."""
    try:
        foreign = metadata.distribution(FOREIGN)
    except metadata.PackageNotFoundError:
        return ""
    if "\nsafety_harness/" not in f"\n{foreign.read_text('RECORD') or ''}":  # an editable install has none
        return ""
    return (
        f"{FOREIGN} {foreign.version}, another project, has files in the folder of {DISTRIBUTION}: "
        f"pip uninstall {FOREIGN} {DISTRIBUTION}, then install {DISTRIBUTION} again"
    )
