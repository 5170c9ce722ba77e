from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from safety_harness.base.exceptions import InputError, InstallationError
from safety_harness.extensions.assurance.certification import certify
from safety_harness.extensions.assurance.certification.findings import of_selftest
from safety_harness.extensions.assurance.certification.tools import FaultState, read_oracles, read_selftest
from safety_harness.extensions.selftest.document import document
from tests.selftest.made_up_faults import EVERY_KIND, about

DOCS = Path(__file__).parents[3] / "docs"
FOUND: dict[str, Any] = {
    "format": "safety-harness selftest 1",
    "about": {
        "profile": "quick",
        "source_hash": "0",
        "planned": 5,
        "interrupted": False,
        "command": "safety-harness selftest",
    },
    "faults": [
        {
            "fault": "a",
            "part": "gate",
            "hazard": "h",
            "state": "caught",
            "caught_by": "c",
            "slightest_caught": "1",
        },
        {
            "fault": "b",
            "part": "gate",
            "hazard": "h",
            "state": "survives",
            "caught_by": None,
        },
        {"fault": "c", "part": "gate", "hazard": "h", "state": "false alarm", "caught_by": "c"},
        {"fault": "d", "part": "gate", "hazard": "h", "state": "quiet", "caught_by": None},
        {"fault": "e", "part": "gate", "hazard": "h", "state": "a stated limit", "limit": "nobody looks"},
    ],
}


def written(folder: Path, found: object) -> Path:
    file = folder / "file.json"
    file.write_text(json.dumps(found))
    return file


def test_the_kill_table_tells_caught_from_survived_and_false_alarms(tmp_path: Path) -> None:
    read = read_selftest(written(tmp_path, FOUND))
    assert [(fault.name, fault.caught_by) for fault in read.faults] == [("a", "c"), ("b", ""), ("e", "")]
    assert read.false_alarms == ("c",)
    assert read.caught == 1
    assert not read.present  # another source
    assert read.whole


def test_what_selftest_writes_is_read_with_its_limits(tmp_path: Path) -> None:
    read = read_selftest(written(tmp_path, document(EVERY_KIND, about())))
    assert [(fault.name, fault.known_limit) for fault in read.faults] == [
        ("caught", ""),
        ("survives", ""),
        ("limit", "nobody looks there"),
    ]
    assert read.false_alarms == ("loud",)


@pytest.mark.parametrize(
    "changes", [{"interrupted": True}, {"planned": 6}, {"command": "safety-harness selftest --fault sign"}]
)
def test_a_trial_of_some_faults_is_not_the_whole_trial(tmp_path: Path, changes: dict[str, Any]) -> None:
    read = read_selftest(written(tmp_path, FOUND | {"about": FOUND["about"] | changes}))
    assert not read.whole
    assert any("not every fault" in finding.text for finding in of_selftest(read))


def test_what_the_package_measured_of_itself_can_be_read() -> None:
    assert read_selftest(DOCS / "selftest-results.json").caught > 70
    assert len(read_oracles(Path("shipped:plans/oracles.json"))) > 5


@pytest.mark.parametrize(
    "found",
    [
        [],
        FOUND | {"format": "else"},
        FOUND | {"faults": {}},
        FOUND | {"about": 1},
        FOUND | {"faults": []},
        FOUND | {"faults": FOUND["faults"][2:4]},
        FOUND | {"faults": [FOUND["faults"][0] | {"state": "fine"}]},
        FOUND | {"about": FOUND["about"] | {"interrupted": None}},
        FOUND | {"faults": [FOUND["faults"][0] | {"hazard": 3}]},
    ],
)
def test_what_is_no_kill_table_is_refused(tmp_path: Path, found: object) -> None:
    with pytest.raises(InputError):
        read_selftest(written(tmp_path, found))


@pytest.mark.parametrize(
    "found", [{}, [1], [{"what": "a", "oracle": "b", "unit": "mm", "largest": "0"}], [{"largest": 1.0}]]
)
def test_what_is_no_table_of_oracles_is_refused(tmp_path: Path, found: object) -> None:
    with pytest.raises(InputError):
        read_oracles(written(tmp_path, found))


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        read_oracles(tmp_path / "none.json")


def test_every_state_of_a_self_test_can_be_read(tmp_path: Path) -> None:
    for state in FaultState:
        more = FOUND | {"faults": [*FOUND["faults"], {"state": state.value}]}
        read_selftest(written(tmp_path, more))


def test_nothing_is_certified_with_two_packages_that_own_one_module(monkeypatch: pytest.MonkeyPatch) -> None:
    certify.refuse_shared_modules()
    owners = {"cv2": ("opencv-python 9.9.9", "opencv-python-headless 4.1")}
    monkeypatch.setattr(certify, "shared_modules", lambda: owners)
    with pytest.raises(InstallationError, match=r"the module cv2: .*opencv-python 9\.9\.9 and opencv-"):
        certify.refuse_shared_modules()
