"""Which software made a trace."""

from __future__ import annotations

import platform
from functools import lru_cache
from importlib import metadata

from safety_harness.compiled import source_hash
from safety_harness.trace.trace import Provenance

LIBRARIES = ("numpy", "numba", "pybullet", "eaik", "example-robot-data", "opencv-python-headless")


@lru_cache
def provenance(world: str, avoider: str) -> Provenance:
    """Provenance of a run in this process."""
    return Provenance(
        package_version=metadata.version("safety-harness"),
        source_hash=source_hash(),
        world=world,
        avoider=avoider,
        python=platform.python_version(),
        platform=f"{platform.system()} {platform.machine()}",
        libraries=tuple((name, metadata.version(name)) for name in LIBRARIES),
    )
