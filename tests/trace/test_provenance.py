"""What is said of the software is what was loaded, whatever installers noted down."""

from __future__ import annotations

import base64
import hashlib
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import pytest
from examples import scenario

from safety_harness.base.settings import DEFAULTS, ImageSource
from safety_harness.cell.simulation.worlds import libraries_of
from safety_harness.trace import provenance as software
from safety_harness.trace.provenance import provenance, shared_modules
from safety_harness.trace.trace import Provenance


@pytest.fixture(autouse=True)
def forgetful() -> Iterator[None]:
    """Packages that a test installs are seen, and forgotten after it."""
    forget()
    yield
    forget()


def installed(folder: Path, name: str, version: str, *, record: str = "", names: str = "") -> None:
    """Metadata of a package, without the package."""
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    (info / "RECORD").write_text(record)
    (info / "top_level.txt").write_text(names)


def of_every_library() -> Provenance:
    return provenance("world", tuple(software.LIBRARIES))


def opencv_file() -> tuple[str, str]:
    return next(pair for pair in of_every_library().files if pair[0].startswith("cv2/"))


def recorded(sha256: str) -> str:
    return base64.urlsafe_b64encode(bytes.fromhex(sha256)).decode().rstrip("=")


def test_each_compiled_file_is_named_with_the_hash_of_what_is_loaded() -> None:
    files = dict(of_every_library().files)
    assert len(files) == len(software.LIBRARIES)
    import pybullet

    name = Path(pybullet.__file__).name
    assert files[name] == hashlib.sha256(Path(pybullet.__file__).read_bytes()).hexdigest()
    assert not any(Path(name).is_absolute() for name in files)


def test_the_version_is_that_of_the_package_whose_file_is_loaded_not_of_another_that_owns_the_module(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    name, _ = opencv_file()
    installed(tmp_path, "opencv-python", "9.9.9", record=f"{name},sha256={recorded('00' * 32)},1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    forget()
    libraries = dict(of_every_library().libraries)
    assert "opencv-python-headless" in libraries
    assert "opencv-python" not in libraries


def test_the_package_of_the_other_name_is_believed_where_its_file_is_the_loaded_one(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    name, sha256 = opencv_file()
    installed(tmp_path, "opencv-python", "9.9.9", record=f"{name},sha256={recorded(sha256)},1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    forget()
    assert dict(of_every_library().libraries)["opencv-python"] == "9.9.9"


def test_a_file_that_no_package_records_has_the_version_that_its_module_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(metadata, "distributions", lambda: iter(()))
    forget()
    libraries = dict(of_every_library().libraries)
    assert libraries["numpy"] == sys.modules["numpy"].__version__
    assert libraries["pybullet"] == "of a version that it does not say"


def test_what_is_not_there_is_said_to_be_not_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    found = provenance("pybullet", ("pybullet",))
    assert dict(found.libraries)["pybullet"] == "not loaded"
    assert not any(name.startswith("pybullet") for name, _ in found.files)


def test_a_run_names_what_it_used_and_nothing_else_whatever_is_loaded() -> None:
    engines = {"pybullet", "opencv-python-headless", "onnxruntime"}
    rendered = replace(DEFAULTS, camera=replace(DEFAULTS.camera, source=ImageSource.RENDERED))
    for world, what, own in (
        ("kinematic", scenario(), set[str]()),
        ("pybullet", scenario(), {"pybullet"}),
        ("pybullet", scenario(settings=rendered), {"pybullet", "opencv-python-headless"}),
        ("kinematic", scenario(avoider="mine.onnx"), {"onnxruntime"}),
        ("somebody's own", scenario(), set[str]()),
    ):
        named = dict(provenance(world, libraries_of(world, what)).libraries)
        assert named.keys() & engines == own
        assert {"numpy", "numba"} <= named.keys()


@pytest.mark.parametrize("how", [{"names": "cv2\n"}, {"record": "cv2/__init__.py,,\n"}])
def test_two_packages_that_own_one_module_are_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, how: dict[str, str]
) -> None:
    assert shared_modules() == {}
    installed(tmp_path, "opencv-python", "9.9.9", **how)
    monkeypatch.syspath_prepend(str(tmp_path))
    forget()
    first, second = shared_modules()["cv2"]
    assert first == "opencv-python 9.9.9"
    assert second.startswith("opencv-python-headless ")


def test_the_same_package_found_twice_is_no_second_owner(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    installed(tmp_path, "opencv-python-headless", "1.0", names="cv2\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    forget()
    assert shared_modules() == {}


def forget() -> None:
    for one in vars(software).values():
        if hasattr(one, "cache_clear") and one.__module__ == software.__name__:
            one.cache_clear()
