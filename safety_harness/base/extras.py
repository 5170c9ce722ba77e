"""The packages that not everybody needs: what is said where one is missing.

An ``Extra`` is an optional part of the installation.  Its packages are imported where they are used, within
``with IMAGES.needed("rendered images"):``, and nowhere else.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from safety_harness.base.distribution import DISTRIBUTION
from safety_harness.base.exceptions import MissingPackageError, Place


@dataclass(frozen=True)
class Extra:
    """An optional part of this package: its ``modules``, what for, and what to do where it cannot be had.

    ``package`` is what installs the first of its modules, if that is of another name.
    """

    name: str
    modules: tuple[str, ...]
    use: str
    package: str = ""
    instead: str = ""
    newest_wheel: tuple[int, int] | None = None  # of Python; None: there are wheels for all

    @property
    def hint(self) -> str:
        """How to get it with this Python, or do without."""
        get = f"pip install '{DISTRIBUTION}[{self.name}]'"
        if self.newest_wheel is not None and sys.version_info[:2] > self.newest_wheel:
            newest = ".".join(map(str, self.newest_wheel))
            module = self.modules[0]
            get = f"it has no wheel above Python {newest}; pip install {module} builds it from its source"
        return "; ".join(filter(None, (get, self.instead)))

    @contextmanager
    def needed(self, by: str, file: Path | None = None) -> Iterator[None]:
        """Import its packages within; MissingPackageError if one is not installed, and ``by`` needs it.

        ``file`` is what asks for ``by``, if that is a file.

        Any other module that is missing is somebody's mistake, and raised as it is.
        """
        try:
            yield
        except ModuleNotFoundError as error:
            module = (error.name or "").partition(".")[0]
            if module not in self.modules:
                raise
            raise MissingPackageError(
                place=Place(file=file, field=by), expected=module, got="no such package", hint=self.hint
            ) from error

    def require(self, by: str, file: Path | None = None) -> None:
        """Look for its first package without importing it; MissingPackageError as of ``needed``."""
        with self.needed(by, file):
            if find_spec(self.modules[0]) is None:
                raise ModuleNotFoundError(name=self.modules[0])


PYBULLET = Extra(
    "pybullet",
    ("pybullet",),
    "the reference world and rendered images; without it runs are kinematic",
    instead="the kinematic world does without: --world kinematic (pytest: --safety-world; a plan: world:)",
    newest_wheel=(3, 11),
)
IMAGES = Extra(
    "images",
    ("cv2",),
    "hands in rendered images",
    package="opencv-python-headless",
    instead="exact and raster images need none",
)
ONNX = Extra("onnx", ("onnxruntime", "onnx"), "avoiders in FILE.onnx, and proofs about them")
LEARNING = Extra("learning", ("torch", "onnx", "onnxscript"), "safety-harness train and export")
FITTING = Extra("fitting", ("trimesh", "collada"), "safety-harness robot fit")
EXPORT = Extra("export", ("pyarrow",), "campaigns as Parquet files", instead="a .csv needs none")
LOGS = Extra("logs", ("rosbags", "pyarrow"), "logs in MCAP, ROS 2 bags, Parquet", instead="a .csv needs none")
CLUSTER = Extra(
    "cluster",
    ("distributed", "dask"),
    "campaigns on a Dask cluster",
    instead="without --cluster it runs on this machine",
)
GYM = Extra("gym", ("gymnasium",), "worlds as Gymnasium environments")
POLICIES = Extra(
    "policies", ("stable_baselines3",), "policies trained in environments", package="stable-baselines3"
)
EXTRAS = (PYBULLET, IMAGES, ONNX, LEARNING, FITTING, EXPORT, LOGS, CLUSTER, GYM, POLICIES)
