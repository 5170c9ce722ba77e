"""Save and load data sets: a folder with plain arrays and with a manifest of their origin.

``arrays.npz`` holds the compact arrays (never a pickle).  ``manifest.json`` holds every parameter, the seed
and the versions.  It also holds a sha256 of each array's bytes and of the manifest itself, so that
``load_dataset`` refuses a changed data set.
"""

from __future__ import annotations

import hashlib
import json
import platform
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import source_hash
from safety_harness.base.distribution import installed_version
from safety_harness.base.exceptions import DatasetError, OutputError, Place, RegionError
from safety_harness.base.settings import Settings
from safety_harness.base.whole_file import replacing, write_whole
from safety_harness.extensions.lab.learning.dataset import CompactDataset, Space
from safety_harness.scenario.files import refuse_no_file
from safety_harness.scenario.kinds import FileKind, refuse_other_kind
from safety_harness.scenario.robots import Robot
from safety_harness.scenario.typed_json import of_format, plain, read_json, typed

FORMAT = "safety-harness dataset 1"
ARRAYS, MANIFEST = "arrays.npz", "manifest.json"
LARGEST_BYTES = 2**30  # unpacked; the paper's data set has 0.8 MB
LARGEST_MANIFEST_BYTES = 4_000_000
DTYPES = {
    "tcp_in_base": np.float64,
    "selected_in_base": np.float64,
    "optimum_in_base": np.float64,
    "candidates_in_view": np.int64,
    "hand_in_base": np.float64,
}


@dataclass(frozen=True)
class _StoredArray:
    """The hash of an array according to the manifest."""

    sha256: str


@dataclass(frozen=True)
class _Read:
    """The fields of a manifest that are necessary to load a data set, including the complete settings."""

    seed: int
    tcps: int
    hands: int
    candidates: int
    space: Space
    settings: Settings
    arrays: dict[str, _StoredArray]
    arm: str = Robot.UR10.label


def manifest_of(dataset: CompactDataset) -> dict[str, Any]:
    """Return the manifest of ``dataset``.

    Its field ``sha256`` is a hash of the parameters, the software versions and the data.
    """
    manifest = {
        "format": FORMAT,
        "package_version": installed_version(),
        "source_hash": source_hash(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "arm": dataset.arm,
        "seed": dataset.seed,
        "tcps": dataset.tcps,
        "candidates": dataset.candidates,
        "hands": dataset.hands,
        "samples": len(dataset),
        "views_without_object": dataset.views_without_object,
        "tcps_without_view": dataset.tcps_without_view,
        "space": plain(dataset.space),
        "settings": plain(dataset.settings),
        "arrays": {
            name: {"sha256": _sha256(array), "dtype": array.dtype.str, "shape": list(array.shape)}
            for name, array in _arrays(dataset).items()
        },
    }
    return manifest | {"sha256": _manifest_hash(manifest)}


# The hash of the shipped networks' data, with today's arithmetic and with the arithmetic of their training.
# Of the five arrays only the optimum differs, by at most 1.2e-16 m.
_WITH_ARITHMETIC_0 = {
    "9c8d51eaed28783185f43c7f349788f0075cb071d06ec007af7e318f2f38b7c3": (
        "1966e834dde8e7ad166ee64c07d5c613dda54ccdcbba2ec1a6b8fb86760c09d3"
    )
}


def is_named_by(dataset: CompactDataset, sha256: str) -> bool:
    """Return True if ``sha256`` is the ``data_hash`` of ``dataset``.

    For the shipped networks' data, the function also accepts the hash of an earlier version, whose arithmetic
    rounded differently.
    """
    digest = data_hash(dataset)
    return sha256 in (digest, _WITH_ARITHMETIC_0.get(digest))


def data_hash(dataset: CompactDataset) -> str:
    """Return the sha256 of the arrays of ``dataset``.

    The hash does not depend on the program's version.
    """
    digest = hashlib.sha256()
    for name, array in sorted(_arrays(dataset).items()):
        digest.update(f"{name} {_sha256(array)}\n".encode())
    return digest.hexdigest()


def save_dataset(dataset: CompactDataset, folder: Path) -> None:
    """Write ``arrays.npz`` and ``manifest.json`` into ``folder``.

    The function creates the folder if necessary, and writes each file atomically.  If it is interrupted
    between the two files, the hashes differ, so ``load_dataset`` refuses the folder.

    Args:
        dataset: The data set.
        folder: The folder.

    Raises:
        OutputError: The folder cannot be written.

    """
    try:
        with replacing(folder / ARRAYS) as unfinished, unfinished.open("wb") as file:
            np.savez(file, allow_pickle=False, **_arrays(dataset))
        write_whole(folder / MANIFEST, json.dumps(manifest_of(dataset), indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise OutputError(
            place=Place(file=folder), expected="a folder that can be written", got=str(error)
        ) from error


def load_dataset(folder: Path) -> CompactDataset:
    """Return the data set that ``save_dataset`` wrote into ``folder``; raise DatasetError if that fails."""
    refuse_other_kind(folder, FileKind.DATASET, error=DatasetError)
    file = folder / MANIFEST
    manifest = _read_manifest(file)
    try:
        read = typed(manifest, _Read, file, further_fields=True, error=DatasetError)
        settings = typed(manifest["settings"], Settings, file, where="settings", error=DatasetError)
    except RegionError as error:
        raise _error(file, "a manifest as this version writes it", str(error), "space") from error
    arrays = _read_arrays(folder / ARRAYS, read.arrays)
    dataset = CompactDataset(settings=settings, space=read.space, seed=read.seed, arm=read.arm, **arrays)
    for name in ("tcps", "hands", "candidates"):
        number, stated = getattr(dataset, name), getattr(read, name)
        if number != stated:
            raise _error(file, f"{number}, as the arrays have", str(stated), name)
    return dataset


def _arrays(dataset: CompactDataset) -> dict[str, NDArray[Any]]:
    """Return the arrays of ``dataset`` that a file stores, with their names as keys."""
    return {name: getattr(dataset, name) for name in DTYPES}


def _sha256(array: NDArray[Any]) -> str:
    """Return the sha256 of an array's bytes, in little-endian order."""
    little_endian = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
    return hashlib.sha256(little_endian.tobytes()).hexdigest()


def _manifest_hash(manifest: dict[str, Any]) -> str:
    """Return a hash of all fields except ``sha256``.

    White space in the file has no effect on the hash.
    """
    rest = {name: value for name, value in manifest.items() if name != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def _error(file: Path, expected: str, got: str, field: str | None = None) -> DatasetError:
    return DatasetError(place=Place(file=file, field=field), expected=expected, got=got)


def _read_manifest(path: Path) -> dict[str, Any]:
    """Return the manifest in ``path``, and raise DatasetError if it was changed or has another format."""
    refuse_no_file(path, "the manifest of a data set", DatasetError)
    content = read_json(path, "the manifest of a data set", most=LARGEST_MANIFEST_BYTES, error=DatasetError)
    manifest = of_format(content, FORMAT, path, DatasetError)
    if manifest.get("sha256") != _manifest_hash(manifest):
        raise _error(path, "a manifest as it was written", "one that was changed since", "sha256")
    return manifest


def _read_arrays(path: Path, described: dict[str, _StoredArray]) -> dict[str, Any]:
    """Load the arrays in ``path``, and check them against the hashes in the manifest."""
    arrays: dict[str, NDArray[Any]] = {}
    refuse_no_file(path, "the arrays of a data set", DatasetError)
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(info.file_size for info in archive.infolist())
            if size > LARGEST_BYTES:
                raise _error(path, f"at most {LARGEST_BYTES} bytes unpacked", f"{size} bytes")
        with np.load(path, allow_pickle=False) as stored:
            for name in DTYPES:
                arrays[name] = stored[name]
    except DatasetError:
        raise
    except KeyError as error:
        raise _error(path, f"the arrays {', '.join(DTYPES)}", f"{error}") from error
    except Exception as error:  # zlib.error, struct.error or any other exception from damaged bytes
        raise _error(path, "arrays in a .npz file, whole", f"{type(error).__name__}: {error}") from error
    for name, dtype in DTYPES.items():
        array, counted = arrays[name], arrays["hand_in_base" if name == "hand_in_base" else "tcp_in_base"]
        rows = len(counted) if counted.ndim else 0
        shape = (rows,) if name == "candidates_in_view" else (rows, 3)
        if array.dtype != dtype or array.shape != shape or rows == 0:
            expected = f"{np.dtype(dtype)} of shape {shape}, not empty"
            raise _error(path, expected, f"{array.dtype} of shape {array.shape}", name)
        if name not in described:
            raise _error(path.with_name(MANIFEST), "this field", "none", f"arrays.{name}")
        promised, actual = described[name].sha256, _sha256(array)
        if promised != actual:
            raise _error(path, f"data with sha256 {promised}", f"sha256 {actual}", name)
    return arrays
