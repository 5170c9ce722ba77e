"""Read every URDF of the package example-robot-data: what is read, what it lacks, why a file is refused.

``python benchmarks/public_urdfs.py`` writes URDFS.md.  An arm is a chain of 3 to 8 turning joints that ends
at a link without a joint below it; a file counts as read if one of its arms is.
"""

from __future__ import annotations

import re
import sys
from collections import Counter, defaultdict
from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path

from safety_harness.cell.robot.description import MOST, ArmModel, read_arm
from safety_harness.cell.robot.urdf import ArmFileError, Urdf

PACKAGE = "example-robot-data"
MAKERS = {
    "Aldebaran": ["romeo"],
    "ANYbotics": ["anymal"],
    "Boardwalk Robotics": ["alex_"],
    "Franka Robotics": ["panda"],
    "IIT": ["icub", "hyq", "centauro"],
    "IHMC": ["alexander"],
    "Kinova": ["kinova"],
    "Open Dynamic Robot Initiative": ["solo", "bolt", "finger_edu"],
    "PAL Robotics": ["talos", "tiago"],
    "Rethink Robotics": ["baxter"],
    "The Robot Studio": ["so_arm"],
    "UFACTORY": ["xarm"],
    "Unitree": ["a1", "b1", "g1", "go1", "go2", "laikago", "z1"],
    "Universal Robots": ["ur_"],
    "Willow Garage": ["pr2"],
    "Wonik Robotics": ["allegro"],
}
REASONS = {  # for which a file may be refused, by a pattern of the message
    "fewer than 3 turning joints": r"3 to 8 turning joints",
    "no link": r"no link",
    "a revolute joint without a range": r"a lower limit below the upper one; got 0 and 0",
    "a mesh file that is not in the package": r"the name of a mesh file",
}


@dataclass(frozen=True)
class Reading:
    """What came of one file: its arms, what these lack, and the reasons of those that were refused."""

    name: str
    arms: int
    lacks: frozenset[str]
    refused: Counter[str]

    @property
    def reason(self) -> str:
        """Why no arm was read."""
        return "" if self.arms else self.refused.most_common(1)[0][0]


def package_folder() -> Path:
    """The folder ``robots`` of the package; PackageNotFoundError if it is not installed."""
    file = next(file for file in distribution(PACKAGE).files or () if file.suffix == ".urdf")
    path = Path(str(file.locate())).resolve()
    return next(
        folder for folder in path.parents if folder.name == "robots" and folder.parent.name == PACKAGE
    )


def readings(folder: Path) -> list[Reading]:
    """Each URDF below ``folder``."""
    return [_reading(file, folder) for file in sorted(folder.rglob("*.urdf"))]


def _reading(file: Path, folder: Path) -> Reading:
    name, lacks, refused, arms = file.relative_to(folder).as_posix(), set[str](), Counter[str](), 0
    urdf = Urdf.read(file)
    inner = {urdf.parent(joint) for joint in urdf.above.values()}
    tips = [link for link in urdf.links if link not in inner]
    if not tips:
        refused["no link"] += 1
    for tip in tips:
        try:
            arm = _arm(file, urdf, tip, folder)
        except ArmFileError as error:
            refused[reason_of(str(error))] += 1
            continue
        arms += 1
        lacks |= {re.sub(" of .*|,.*", "", lack.what) for lack in arm.lacks}
    return Reading(name, arms, frozenset(lacks), refused)


def _arm(file: Path, urdf: Urdf, tip: str, folder: Path) -> ArmModel:
    """The longest arm that ends at ``tip``."""
    base, turning = tip, 0
    while (joint := urdf.above.get(base)) is not None and joint.find("mimic") is None:
        turns = joint.get("type") in ("revolute", "continuous")
        if not (turns or joint.get("type") == "fixed") or turning + turns > MOST:
            break
        base, turning = urdf.parent(joint), turning + turns
    packages = {PACKAGE: folder.parent, f"{PACKAGE}/robots": folder}
    return read_arm(file, base=base, tcp=tip, packages=packages)


def reason_of(message: str) -> str:
    """Which of ``REASONS`` a message states; the message itself if it is another."""
    return next((name for name, pattern in REASONS.items() if re.search(pattern, message)), message)


def maker_of(name: str) -> str:
    """Who makes the robot of a file, as far as ``MAKERS`` knows."""
    starts = ((maker, start) for maker, all_starts in MAKERS.items() for start in all_starts)
    return next((maker for maker, start in starts if name.startswith(start)), "others")


def table(found: list[Reading]) -> str:
    """The table by maker."""
    by_maker = defaultdict[str, list[Reading]](list)
    for reading in found:
        by_maker[maker_of(reading.name)].append(reading)
    rows = ["| maker | files | read | arms | what some lack | refused |", "|---|---|---|---|---|---|"]
    for maker in sorted(by_maker, key=lambda maker: (maker == "others", maker)):
        rows.append(_row(maker, by_maker[maker]))
    return "\n".join((*rows, _row("all", found)))


def _row(maker: str, found: list[Reading]) -> str:
    lacks = ", ".join(sorted(set().union(*(reading.lacks for reading in found)))) or "nothing"
    reasons = Counter(reading.reason for reading in found if reading.reason)
    refused = ", ".join(f"{count}: {reason}" for reason, count in sorted(reasons.items())) or "none"
    read, arms = sum(reading.arms > 0 for reading in found), sum(reading.arms for reading in found)
    return f"| {maker} | {len(found)} | {read} | {arms} | {lacks} | {refused} |"


def main() -> None:
    """Write URDFS.md."""
    found = readings(package_folder())
    version = distribution(PACKAGE).version
    text = (
        f"# The URDFs of {PACKAGE} {version}\n\nA file is read if one arm of it is: 3 to 8 turning joints in "
        "a row that end at a link without a joint below it. What an arm lacks is asked for by what needs it "
        f"alone ([robots](../docs/how-to/robot.md)).\n\n{table(found)}\n"
    )
    Path(__file__).with_name("URDFS.md").write_text(text, encoding="utf-8")
    sys.stdout.write(text)


if __name__ == "__main__":
    main()
