"""The software that made a trace, identified by the modules loaded in this process.

The records of an installer are not sufficient. Two packages may install the same module (``opencv-python``
beside ``opencv-python-headless``). Then the files of one package replace the other's files, but the metadata
of both remain. So a version is accepted only if the package's record has the hash of the loaded file.
"""

from __future__ import annotations

import hashlib
import platform
import re
import sys
from base64 import urlsafe_b64encode
from contextlib import suppress
from functools import lru_cache
from importlib import import_module, metadata
from pathlib import Path
from types import ModuleType

import numpy as np

from safety_harness.base.compiled import PACKAGE, cache_root, code_in_use, source_hash
from safety_harness.base.distribution import installed_version
from safety_harness.base.elementary import ARITHMETIC
from safety_harness.base.extension_points import foreign_parts
from safety_harness.base.whole_file import sha256_of, write_whole
from safety_harness.trace.trace import Provenance

# Each library, with the compiled module that does its work.
LIBRARIES = {
    "numpy": f"numpy.{'_core' if np.__version__[0] != '1' else 'core'}._multiarray_umath",
    "numba": "numba._dispatcher",
    "pybullet": "pybullet",
    "mujoco": "mujoco._structs",
    "cv2": "cv2",
}
OF_EVERY_RUN = ("numpy", "numba")
# Processor features by which libraries choose their code, with numpy's names of the features.
FEATURES = {"AVX-512": ("AVX512F", "X86_V4"), "AVX2": ("AVX2", "X86_V3"), "FMA": ("FMA3", "X86_V3")}
DATA = "robot data"
ROBOTS = PACKAGE / "cell" / "robot" / "data" / "ur_description"
ELSEWHERE = "onnxruntime"  # another process loads it, for a user's file
ONE_OWNER = (*LIBRARIES, ELSEWHERE, "scipy", "safetensors")
_OWNED = re.compile(rf"\n({'|'.join(ONE_OWNER)})(?:/|\.[^,/\n]*(?:py|so|pyd),)")
NOT_LOADED = "not loaded"


@lru_cache
def provenance(world: str, used: tuple[str, ...] = ()) -> Provenance:
    """Return the provenance of a run in this process.

    Libraries that other code loaded are left out, because they depend on the history of the process.

    Args:
        world: The world that simulated the run.
        used: The libraries that this run used in addition to ``OF_EVERY_RUN``.

    """
    named = (library for library in LIBRARIES if library in (*OF_EVERY_RUN, *used))
    loaded = [_loaded(library, _imported(LIBRARIES[library])) for library in named]
    loaded += [(_by_metadata(library), None) for library in used if library == ELSEWHERE]
    data = DATA, hashlib.sha256("".join(map(_sha256, sorted(ROBOTS.rglob("*.*")))).encode()).hexdigest()
    foreign = ((f"entry point {part}", part.value) for part in foreign_parts())
    return Provenance(
        package_version=installed_version(),
        source_hash=source_hash(),
        world=world,
        python=platform.python_version(),
        platform=f"{platform.system()} {platform.machine()}",
        libraries=(*(named for named, _ in loaded), data, *foreign),
        files=tuple(file for _, file in loaded if file is not None),
        arithmetic=ARITHMETIC,
        machine=machine(),
    )


@lru_cache
def machine() -> str:
    """Return a text on this machine: its processor, its C library, and the origin of its machine code."""
    there = getattr(_imported(LIBRARIES["numpy"]), "__cpu_features__", {})
    features = [feature for feature, names in FEATURES.items() if any(there.get(name) for name in names)]
    c_library = " ".join(platform.libc_ver()).strip() or "an unnamed C library"
    processor = f"{platform.machine()} with {', '.join(features) or 'no vector features'}"
    return f"{processor}, {c_library}, {code_in_use()}"


def shared_modules() -> dict[str, tuple[str, ...]]:
    """Return the modules that belong to several installed packages.

    Each module has a list of these packages and their versions.
    """
    owners = {module: _owners(module) for module in ONE_OWNER}
    return {
        module: tuple(sorted(f"{name} {distribution.version}" for name, distribution in packages.items()))
        for module, packages in owners.items()
        if len(packages) > 1
    }


def _imported(core: str) -> ModuleType | None:
    try:
        return import_module(core)
    except ImportError:
        return None


def _by_metadata(library: str) -> tuple[str, str]:
    for package, distribution in _owners(library).items():
        return package, f"{distribution.version} by its metadata"
    return library, NOT_LOADED


def _loaded(library: str, core: ModuleType | None) -> tuple[tuple[str, str], tuple[str, str] | None]:
    """Return two pairs: the name and version of a library, and the name and hash of its compiled file."""
    if core is None:
        return (library, NOT_LOADED), None
    path = Path(str(getattr(core, "_native", core).__file__))  # cv2 has its compiled part below itself
    path = next(path.parent.glob(f"lib{library}.so*"), path)  # mujoco's module only binds the engine
    name = "/".join(path.parts[path.parts.index(library) :]) if library in path.parts else path.name
    digest = _sha256(path)
    return _version(library, name, digest), (name, digest)


def _version(library: str, name: str, sha256: str) -> tuple[str, str]:
    recorded = urlsafe_b64encode(bytes.fromhex(sha256)).decode().rstrip("=")
    for package, distribution in _owners(library).items():
        if f"\n{name},sha256={recorded}," in f"\n{distribution.read_text('RECORD') or ''}":
            return package, distribution.version
    own = getattr(sys.modules.get(library), "__version__", None)
    return library, str(own) if own else "of a version that it does not say"


@lru_cache
def _owners(module: str) -> dict[str, metadata.Distribution]:
    """Return the installed packages that contain ``module``, with their names as keys.

    ``module`` is a module of ONE_OWNER.
    """
    return {name: distribution for owned, name, distribution in _installed() if owned == module}


@lru_cache
def _installed() -> tuple[tuple[str, str, metadata.Distribution], ...]:
    """Return each module of ONE_OWNER with each package that contains it.

    If several installations of a package have the same name, the first is used. A package's list of names or
    of files shows its modules. ``metadata.packages_distributions`` would return the same information, but it
    takes a second.
    """
    owners: dict[tuple[str, str], metadata.Distribution] = {}
    for distribution in metadata.distributions():
        owned = set((distribution.read_text("top_level.txt") or "").split())
        owned.update(_OWNED.findall(f"\n{distribution.read_text('RECORD') or ''}"))
        for module in owned.intersection(ONE_OWNER):
            owners.setdefault((module, distribution.name.lower()), distribution)
    return tuple((module, name, distribution) for (module, name), distribution in owners.items())


@lru_cache
def _sha256(path: Path) -> str:
    """Return the hash of a file.

    The file is read only if it has changed, because pybullet's files have 140 MB. The hash is stored in a
    note beside the machine code. The name of the note depends on the file's path, device, inode number, size,
    and times of change. Whoever overwrites or replaces the file changes at least one of these.
    """
    known = path.stat()
    identity = known.st_dev, known.st_ino, known.st_size, known.st_mtime_ns, known.st_ctime_ns
    name = hashlib.sha256(f"{path} {identity}".encode()).hexdigest()[:32]
    noted = cache_root() / "hashes-of-libraries" / name
    try:
        digest = noted.read_text()
    except OSError:
        digest = ""
    if not re.fullmatch("[0-9a-f]{64}", digest):
        digest = sha256_of(path)
        with suppress(OSError):
            write_whole(noted, digest)
    return digest
