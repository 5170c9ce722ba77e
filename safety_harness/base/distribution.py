"""The distribution that contains this package: its name, its version, and its conflict with another project.

The import name is ``safety_harness`` and the command is ``safety-harness``.  However, the distribution on
PyPI with the name ``safety-harness`` belongs to another project.  Installing that project with pip overwrites
our files, because it also has a folder ``safety_harness``.
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
    """Return a warning if the other project has files in our folder, or an empty text if it has not."""
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
