"""Python as if no wing were installed: with this folder on ``PYTHONPATH``, in every process of a test.

``safety_harness.extensions`` cannot be imported, and no entry point leads there: "make test-core".
"""

import sys
from importlib import metadata
from types import ModuleType

HIDDEN = "safety_harness.extensions"
OF_WINGS = (f"{HIDDEN}.", "safety_harness_paper.")  # which imports them


class NoWings:
    """Finds that what is hidden is not there."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: ModuleType | None = None) -> None:
        """None for any other name, which the next finder looks for."""
        if name == HIDDEN or name.startswith(f"{HIDDEN}."):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def _without_wings(distribution: metadata.Distribution) -> metadata.EntryPoints:
    found = _all_of(distribution)
    return metadata.EntryPoints(
        one for one in found if not one.value.startswith((HIDDEN, "safety_harness_paper"))
    )


_all_of = metadata.Distribution.entry_points.fget
metadata.Distribution.entry_points = property(_without_wings)
sys.meta_path.insert(0, NoWings)
