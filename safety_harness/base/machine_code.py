"""Load machine code for any x86-64 processor from a wheel, so that the first run need not compile.

``make wheel`` compiles for numba's *generic* processor, whose results are the same bit for bit.  Numba stores
its index and its code as pickles, and reading a pickle can execute any code.  Therefore this module reads a
file only if it is in the package's own folder and its SHA-256 is in the installation's RECORD.
"""

from __future__ import annotations

import logging
from base64 import urlsafe_b64encode
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from numba.core.caching import IndexDataCacheFile

from safety_harness.base.distribution import DISTRIBUTION
from safety_harness.base.whole_file import sha256_of

FOLDER = "machine_code"
GENERIC = ("generic", "")  # numba's processor and its features
# Numba compares the source's time and size.  Our folder's name covers the source's content instead.
STAMP = (0.0, 0)
LOGGER = logging.getLogger("safety_harness")

_IndexDataCacheFile: Any = IndexDataCacheFile


class InstalledCode(_IndexDataCacheFile):  # type: ignore[misc]
    """The machine code of one function in the package's folder."""

    def __init__(self, folder: Path, filename_base: str) -> None:
        super().__init__(cache_path=str(folder), filename_base=filename_base, source_stamp=STAMP)
        self._package = folder.parents[1]

    def load_generic(self, key: tuple[Any, tuple[str, str, str], Any]) -> Any:
        """Return the generic machine code for a function, or None if there is no such code.

        ``key`` is numba's key for the host's processor.
        """
        signature, (triple, _, _), hashes = key
        return self.load((signature, (triple, *GENERIC), hashes))

    def _load_index(self) -> Any:
        """Return numba's index, or an empty index if the file's hash is not in RECORD."""
        return super()._load_index() if is_as_installed(Path(self._index_path), self._package) else {}

    def _load_data(self, name: str) -> Any:
        """Return one file of machine code, or None if the file's hash is not in RECORD."""
        path = Path(self._data_path(name))
        return super()._load_data(name) if is_as_installed(path, self._package) else None


def is_as_installed(file: Path, package: Path) -> bool:
    """Return whether a file is unchanged since the installation of ``package``, according to RECORD.

    If the file's hash differs from RECORD, the function logs a warning.
    """
    expected = recorded_hashes(package).get(file.relative_to(package.parent).as_posix())
    if expected is None or not file.is_file():
        return False
    if urlsafe_b64encode(bytes.fromhex(sha256_of(file))).decode().rstrip("=") == expected:
        return True
    LOGGER.warning("%s is not as it was installed: the function is compiled instead", file)
    return False


@cache
def recorded_hashes(package: Path) -> dict[str, str]:
    """Return the base64 hashes of all machine code files, from the RECORD of ``package``.

    The keys are the files' paths.
    """
    try:
        installation = metadata.distribution(DISTRIBUTION)
    except metadata.PackageNotFoundError:
        return {}
    if Path(str(installation.locate_file(package.name))) != package:
        return {}  # a checkout beside an installation
    begin = f"{package.name}/{FOLDER}/"
    lines = (line.rsplit(",", 2) for line in (installation.read_text("RECORD") or "").splitlines())
    pairs = ((line[0], line[1]) for line in lines if len(line) == 3 and line[0].startswith(begin))
    return {path: sha256.removeprefix("sha256=") for path, sha256 in pairs if sha256.startswith("sha256=")}
