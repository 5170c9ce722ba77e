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

from safety_harness.exceptions import MissingPackageError, Place


@dataclass(frozen=True)
class Extra:
    """An optional part of this package: its ``modules``, and what else to do where it cannot be had."""

    name: str
    modules: tuple[str, ...]
    instead: str = ""
    newest_wheel: tuple[int, int] | None = None  # of Python; None: there are wheels for all

    @property
    def hint(self) -> str:
        """How to get it with this Python, or do without."""
        get = f"pip install 'safety-harness[{self.name}]'"
        if self.newest_wheel is not None and sys.version_info[:2] > self.newest_wheel:
            newest = ".".join(map(str, self.newest_wheel))
            module = self.modules[0]
            get = f"it has no wheel above Python {newest}; pip install {module} builds it from its source"
        return "; ".join(filter(None, (get, self.instead)))

    @contextmanager
    def needed(self, by: str) -> Iterator[None]:
        """Import its packages within; MissingPackageError if one is not installed, and ``by`` needs it.

        Any other module that is missing is somebody's mistake, and raised as it is.
        """
        try:
            yield
        except ModuleNotFoundError as error:
            module = (error.name or "").partition(".")[0]
            if module not in self.modules:
                raise
            raise MissingPackageError(
                place=Place(field=by), expected=module, got="no such package", hint=self.hint
            ) from error

    def require(self, by: str) -> None:
        """Look for its first package without importing it; MissingPackageError as of ``needed``."""
        with self.needed(by):
            if find_spec(self.modules[0]) is None:
                raise ModuleNotFoundError(name=self.modules[0])


PYBULLET = Extra(
    "pybullet",
    ("pybullet",),
    instead="the kinematic world does without: --world kinematic (pytest: --safety-world; a plan: world:)",
    newest_wheel=(3, 11),
)
IMAGES = Extra("images", ("cv2",), instead="exact and raster images need none")
ONNX = Extra("onnx", ("onnxruntime",))
LEARNING = Extra("learning", ("torch", "onnx", "onnxscript"))
FITTING = Extra("fitting", ("trimesh", "collada"))
EXPORT = Extra("export", ("pyarrow",), instead="a .csv needs none")
CLUSTER = Extra("cluster", ("distributed", "dask"), instead="without --cluster it runs on this machine")
