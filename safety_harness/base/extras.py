"""Optional packages, and the error if one of them is missing.

An ``Extra`` is an optional part of the installation.  A module imports the packages of an extra only at the
place of use, within ``with IMAGES.needed("rendered images"):``.
"""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from safety_harness.base.distribution import DISTRIBUTION
from safety_harness.base.exceptions import MissingPackageError, Place


@dataclass(frozen=True)
class Extra:
    """An optional part of this package.

    Args:
        name: The name of the extra, as in ``DISTRIBUTION[name]``.
        modules: The modules that the extra installs.
        use: The features that need the extra.
        package: The name of the package on PyPI, if it differs from the name of the first module.
        instead: A text on how to work without the extra.
        newest_wheel: The newest Python version for which there is a wheel.  None means that every version has
            a wheel.

    """

    name: str
    modules: tuple[str, ...]
    use: str
    package: str = ""
    instead: str = ""
    newest_wheel: tuple[int, int] | None = None  # of Python; None: there are wheels for all

    @property
    def hint(self) -> str:
        """A text on how to install the extra for this Python, or how to work without it."""
        get = f"pip install '{DISTRIBUTION}[{self.name}]'"
        if self.newest_wheel is not None and sys.version_info[:2] > self.newest_wheel:
            newest = ".".join(map(str, self.newest_wheel))
            module = self.modules[0]
            get = f"it has no wheel above Python {newest}; pip install {module} builds it from its source"
        return "; ".join(filter(None, (get, self.instead)))

    @contextmanager
    def needed(self, feature: str, file: Path | None = None) -> Iterator[None]:
        """Raise MissingPackageError if an import within the context fails because the extra is missing.

        Args:
            feature: The feature that needs the packages.
            file: The file that uses the feature, or None if there is no file.

        Raises:
            MissingPackageError: A package of this extra is not installed.
            ModuleNotFoundError: A module outside this extra is missing, which is a programming error.

        """
        try:
            yield
        except ModuleNotFoundError as error:
            module = (error.name or "").partition(".")[0]
            if module not in self.modules:
                raise
            raise MissingPackageError(
                place=Place(file=file, field=feature), expected=module, got="no such package", hint=self.hint
            ) from error

    def require(self, feature: str, file: Path | None = None) -> None:
        """Check, without importing it, that the first module of the extra exists.

        The arguments and errors are the same as in ``needed``.
        """
        with self.needed(feature, file):
            if find_spec(self.modules[0]) is None:
                raise ModuleNotFoundError(name=self.modules[0])


PYBULLET = Extra(
    "pybullet",
    ("pybullet",),
    "the reference world and rendered images",
    instead="or use another world: --world mujoco (extra mujoco) or kinematic; pytest: --safety-world",
    # PyBullet has no wheel for a later Python (seen in 2026).
    newest_wheel=(3, 11),
)
MUJOCO = Extra(
    "mujoco",
    ("mujoco",),
    "the second reference world, also above Python 3.11",
    package="mujoco-core",
    instead="or use another world: --world kinematic",
)
IMAGES = Extra(
    "images",
    ("cv2",),
    "hands in rendered images",
    package="opencv-python-headless",
    instead="exact and raster images work without it",
)
ONNX = Extra("onnx", ("onnxruntime", "onnx"), "avoiders in FILE.onnx, and proofs about them")
LEARNING = Extra("learning", ("torch", "onnx", "onnxscript"), "safety-harness train and export")
FITTING = Extra("fitting", ("trimesh", "collada"), "safety-harness robot fit")
EXPORT = Extra("export", ("pyarrow",), "campaigns as Parquet files", instead="or use a .csv")
LOGS = Extra("logs", ("rosbags", "pyarrow"), "logs in MCAP, ROS 2 bags, Parquet", instead="or use a .csv")
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
EXTRAS = (PYBULLET, MUJOCO, IMAGES, ONNX, LEARNING, FITTING, EXPORT, LOGS, CLUSTER, GYM, POLICIES)


@contextmanager
def quiet_export() -> Iterator[None]:
    """Silence the messages of PyTorch's exporter within the context.

    The messages are not needed, because callers test the exported file.
    """
    logger = logging.getLogger("torch.onnx")
    old_level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        logger.setLevel(old_level)
