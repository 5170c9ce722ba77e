"""Every URDF of a public package is read, or refused for a reason that benchmarks/URDFS.md lists."""

import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"


@pytest.mark.long
def test_every_urdf_of_the_package_is_read_or_refused_for_a_listed_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import public_urdfs

    try:
        folder = public_urdfs.package_folder()
    except PackageNotFoundError:
        pytest.skip("example-robot-data is not installed: make long installs it")
    found = public_urdfs.readings(folder)
    assert len(found) > 60
    assert not {why for reading in found for why in reading.refused} - set(public_urdfs.REASONS)
    assert sum(reading.arms > 0 for reading in found) >= 57
    del sys.modules["public_urdfs"]


def test_a_reason_that_is_not_listed_is_shown_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import public_urdfs

    assert (
        public_urdfs.reason_of("arm.urdf:3: expected 3 to 8 turning joints") == "fewer than 3 turning joints"
    )
    assert public_urdfs.reason_of("arm.urdf:3: another") == "arm.urdf:3: another"
