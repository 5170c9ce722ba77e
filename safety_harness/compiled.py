"""The one way in which this package compiles a function: numba, cached, strict IEEE floats.

Numba's own file cache notices a change of the file that *defines* a function, not of the files
whose functions it calls: after an edit in ``geometry`` an old ``controller`` would go on running.
For a tool that gives evidence that is not acceptable, so our cache folder is named by a hash over
every source file of the package (and numba's version): a change anywhere compiles afresh.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import config

F = TypeVar("F", bound=Callable[..., Any])

numba_config: Any = config  # its settings are made at run time, unknown to type checkers

PACKAGE = Path(__file__).parent


@lru_cache(maxsize=1)
def source_hash() -> str:
    """Sixteen hex digits over the names and contents of every Python file of the package."""
    digest = hashlib.sha256(f"numba {numba.__version__}".encode())
    for path in sorted(PACKAGE.rglob("*.py")):
        digest.update(path.relative_to(PACKAGE).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@lru_cache(maxsize=1)
def cache_folder() -> Path:
    """Where machine code is kept: ``$SAFETY_HARNESS_CACHE``, else the user's cache folder."""
    root = os.environ.get("SAFETY_HARNESS_CACHE") or os.environ.get("XDG_CACHE_HOME")
    base = Path(root) if root else Path.home() / ".cache"
    return base / "safety_harness" / source_hash()


def forget_old_machine_code(days: float = 30.0) -> None:
    """Remove what was compiled from other sources and has not been touched for ``days``."""
    oldest = time.time() - days * 86400.0
    for folder in cache_folder().parent.glob("*"):
        if folder.is_dir() and folder.name != source_hash() and folder.stat().st_mtime < oldest:
            shutil.rmtree(folder, ignore_errors=True)


def compiled(function: F) -> F:
    """Compile ``function`` on its first call and keep the machine code for the next process.

    No ``fastmath`` (results must repeat bit for bit) and no exceptions from divisions: like
    numpy, 0/0 is NaN, which every caller that decides something has to look for.
    """
    before = numba_config.CACHE_DIR
    numba_config.CACHE_DIR = str(cache_folder())
    try:
        return cast(F, numba.njit(cache=True, error_model="numpy")(function))
    finally:
        numba_config.CACHE_DIR = before
