"""Values that are possible alone and not together are refused before a run, at the line that says so."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from safety_harness import admit
from safety_harness.base.exceptions import InadmissibleError, Place
from safety_harness.scenario.read import parse_scenario

FILE = Path("folder/slip.yaml")
BASE = """\
scenario: a slip
duration: 2 s
avoider: opposite pose
tcp start: {offset: [0 mm, -60 mm, 20 mm]}
claims: {gain switch reached: holds}
"""
HAND = """\
hands:
  - hand: right
    starts at: [1.1 m, -0.7 m, 300 mm]
    elbow towards: [1.6 m, -1.2 m, 300 mm]
    moves:
      - wait: 1 s
      - move to: [840 mm, -350 mm, 5 mm]
        speed: 0.5 m/s
"""
TOGETHER = """\
  - hand: left
    together with: right
    apart: [0 mm, 300 mm, 0 mm]
    elbow towards: [1.6 m, 0.5 m, 300 mm]
"""
# One second of a hand that goes down by 400 mm, from 0.4 s to 0.5 s.
DIP = "time_s,right_hand_x_m,right_hand_y_m,right_hand_z_m\n" + "".join(
    f"{k / 100},0,0,{-0.04 * min(max(k - 40, 0), 10)}\n" for k in range(101)
)
RECORDED = f"""\
hands:
  - recording: dip.csv
    sha256: {hashlib.sha256(DIP.encode()).hexdigest()}
    track: right hand
    elbow towards: [5 m, -5 m, 300 mm]
    speed factor: 0.1
    starts at: [1.1 m, -0.7 m, -100 mm]
"""

BOW = "[[-50 mm, -40 mm], [100 mm, 60 mm], [100 mm, -50 mm], [-50 mm, 80 mm]]"
ARROW = "[[-50 mm, -40 mm], [0 mm, -10 mm], [100 mm, -40 mm], [-30 mm, 80 mm]]"


def refusal(text: str) -> InadmissibleError:
    recordings = {hashlib.sha256(DIP.encode()).hexdigest(): DIP.encode()}
    with pytest.raises(InadmissibleError) as caught:
        admit(parse_scenario(text, FILE, recordings))
    return caught.value


@pytest.mark.parametrize(
    ("addition", "at", "field", "expected", "got"),
    [
        # hands
        (
            HAND.replace("300 mm]\n    elbow", "-301 mm]\n    elbow"),
            "starts at",
            "hands[0].starts at",
            "a hand above the table (z = -300 mm)",
            "z = -301 mm",
        ),
        (
            HAND.replace("5 mm", "-320 mm"),
            "move to",
            "hands[0].moves[1].move to",
            "a hand above the table (z = -300 mm)",
            "z = -320 mm",
        ),
        (
            RECORDED.replace("0.1", "1"),
            "starts at",
            "hands[0].starts at",
            "a hand above the table (z = -300 mm)",
            "z = -500 mm after 0.50 s of the run, in dip.csv",
        ),
        (
            HAND.replace("[1.1 m, -0.7 m, 300 mm]", "[0.7 m, -0.06 m, 300 mm]"),
            "starts at",
            "hands[0].starts at",
            "a hand that begins outside the robot, its forearm too",
            "one 1",
        ),
        (  # the hand is beyond the arm, its forearm in it
            HAND.replace("[1.1 m, -0.7 m, 300 mm]", "[0.7 m, 0.2 m, 400 mm]").replace(
                "elbow towards: [1.6 m, -1.2 m, 300 mm]", "elbow towards: [0.7 m, -1.2 m, 400 mm]"
            ),
            "starts at",
            "hands[0].starts at",
            "a hand that begins outside the robot, its forearm too",
            "one ",
        ),
        (
            HAND.replace("    moves:", "    shifted by: [0 m, 0 m, -310 mm]\n    moves:"),
            "move to",
            "hands[0].moves[1].move to",
            "a hand above the table (z = -300 mm)",
            "z = -305 mm with its shift",
        ),
        (
            HAND.replace(
                "wait: 1 s", "{wander: 1 m/s, for: 1 s, within: [[1 m, 0 m, 0 m], [1 m, 1 m, -1 m]]}"
            ),
            "wander",
            "hands[0].moves[0].within",
            "a hand above the table (z = -300 mm)",
            "z = -1000 mm",
        ),
        (
            HAND.replace(
                "wait: 1 s", "{sweep: 1 m/s, from: [1 m, 0 m, 0 m], to: [1 m, 1 m, -1 m], times: 2}"
            ),
            "sweep",
            "hands[0].moves[0].to",
            "a hand above the table (z = -300 mm)",
            "z = -1000 mm",
        ),
        (
            HAND + TOGETHER.replace(" 0 mm]", " -306 mm]"),
            "apart",
            "hands[1].apart",
            "a hand above the table (z = -300 mm)",
            "z = -301 mm",
        ),
        (
            HAND + TOGETHER.replace("[0 mm, 300 mm, 0 mm]", "[-400 mm, 640 mm, 0 mm]"),
            "apart",
            "hands[1].apart",
            "a hand that begins outside the robot, its forearm too",
            "one ",
        ),
        # the cell
        (
            "settings: {cell: {desired tcp position: [1.8 m, 0 m, 350 mm]}}\n",
            "settings",
            "settings.cell.desired tcp position",
            "a desired TCP position that the arm can reach",
            "the position (1800, 0, 350) mm, which has no inverse kinematics",
        ),
        (
            "settings: {cell: {desired tcp position: [700 mm, 300 mm, 350 mm]}}\n",
            "settings",
            "settings.cell.desired tcp position",
            "a desired TCP position with the whole object in the camera's view",
            "the position (700, 300, 350) mm",
        ),
        (
            "object: {position: [700 mm, 400 mm, -300 mm]}\n",
            "object",
            "object.position",
            "a desired TCP position with the whole object in the camera's view",
            "the position (700, 0, 350) mm",
        ),
        (
            "camera: {focal: 4000 px}\n",
            "camera",
            "camera.focal",
            "a desired TCP position with the whole object in the camera's view",
            "the position (700, 0, 350) mm",
        ),
        (
            "settings: {cell: {desired tcp position: [700 mm, 0 mm, -290 mm]}}\n",
            "settings",
            "settings.cell.desired tcp position",
            "a desired TCP position at least 50 mm above the table",
            "the position (700, 0, -290) mm",
        ),
        (
            "settings: {motion: {min singular value: 0.9}}\n",
            "settings",
            "settings.motion.min singular value",
            "a desired TCP position away from singularities",
            "0.",
        ),
        (
            "settings: {cell: {table height: -200 mm}}\n",
            "settings",
            "settings.cell.table height",
            "an object on or above the table (z = -200 mm)",
            "z = -300 mm",
        ),
        (
            "object:\n  polygon: [[-50 mm, -40 mm], [50 mm, -40 mm], [0 mm, 80 mm]]\n",
            "polygon",
            "object.polygon",
            "an object whose interaction matrix has rank 6",
            "rank 5",
        ),
        (
            "object:\n  polygon: [[-66 mm, -40 mm], [67 mm, -40 mm], [2 mm, 80 mm]]\n",
            "polygon",
            "object.polygon",
            "an object whose interaction matrix at the desired pose has a condition number of at most 1000",
            "",
        ),
        (
            "object:\n  polygon: [[0 mm, 0 mm], [50 mm, 0 mm], [100 mm, 0 mm]]\n",
            "polygon",
            "object.polygon",
            "an object with an area",
            "one that cannot be seen",
        ),
        (
            "camera:\n  mount offset: [0 mm, -45 mm, 1 m]\n",
            "mount",
            "camera.mount offset",
            "an object with an area, in front of the camera at the desired pose",
            "one that cannot be seen",
        ),
        (
            "avoider: nearest candidate\nsettings:\n"
            "  avoidance: {nominal hand position: [700 mm, 0 mm, 350 mm]}\n",
            "avoidance",
            "settings.avoidance.nominal hand position",
            "a nominal hand position apart from the desired TCP position",
            "the same position",
        ),
        *(
            (
                f"object:\n  polygon: {polygon}\n{more}",
                "polygon",
                "object.polygon",
                expected,
                got,
            )
            for polygon, more, expected, got in (
                (BOW, "", "an outline that does not cross or touch itself", "one that does"),
                (
                    ARROW,
                    "camera: {source: rendered}\n",
                    "a convex object where images are rendered",
                    "an outline",
                ),
            )
        ),
        (
            "hand sensor:\n  overhead position: [750 mm, -250 mm, -400 mm]\n",
            "overhead",
            "hand sensor.overhead position",
            "a camera above the table (z = -300 mm)",
            "z = -400 mm",
        ),
        # times
        (
            "settings:\n  avoidance: {repulsion speed: 2 m/s}\n",
            "avoidance",
            "settings.avoidance.repulsion speed",
            "a restart delay of at least 0.650 s",
            "0.5 s",
        ),
        (
            "settings:\n  braking: {stop time base: 450 ms}\n",
            "braking",
            "settings.braking.stop time base",
            "a restart delay of at least 0.575 s",
            "0.5 s",
        ),
        (
            "settings:\n  braking: {stop time base: 450 ms}\n  avoidance: {restart delay: 550 ms}\n",
            "avoidance",
            "settings.avoidance.restart delay",
            "a restart delay of at least 0.575 s",
            "0.55 s",
        ),
        # cameras
        ("camera:\n  latency: 2 s\n", "latency", "camera.latency", "at most 62 frames", "2 s"),
        (
            "hand sensor:\n  kind: overhead\n  latency: 2 s\n",
            "latency",
            "hand sensor.latency",
            "at most 62 frames",
            "2 s",
        ),
        (
            "camera:\n  rate: 126 Hz\n",
            "rate",
            "camera.rate",
            'a rate of at most 125 Hz, the rate of the control ticks, or "every tick"',
            "126 Hz",
        ),
        (
            "hand sensor:\n  kind: overhead\n  rate: 60 Hz\nsettings: {clock: {control period: 20 ms}}\n",
            "rate",
            "hand sensor.rate",
            "a rate of at most 50 Hz",
            "60 Hz",
        ),
        *(
            (
                f"hand sensor:\n  {key}: {value}\n",
                key,
                f"hand sensor.{key}",
                f"an ideal hand sensor without a {key} of its own",
                got,
            )
            for key, value, got in (
                ("latency", "33 ms", "0.033"),
                ("rate", "30 Hz", "30"),
                ("dropout", "5 %", "0.05"),
                ("pixel noise", "2 px", "2"),
                ("depth noise", "0.0025 /m", "0.0025"),
                ("detector", "rendered", "rendered"),
            )
        ),
        (
            "hand sensor:\n  kind: eye in hand\n  focal: 500 px\n",
            "focal",
            "hand sensor.focal",
            "an eye-in-hand sensor with the camera's focal, 615 px",
            "500 px",
        ),
        (
            "hand sensor: {kind: eye in hand}\ncamera:\n  focal: 650 px\n",
            "focal",
            "camera.focal",
            "an eye-in-hand sensor with the camera's focal, 650 px",
            "615 px",
        ),
        # faults
        (
            "faults:\n  - hand sensor: sees a false hand\n    at: [750 mm, -250 mm, 2 m]\n",
            "at: [",
            "faults[0].at",
            "a false hand where the hand sensor could see one",
            "(750, -250, 2000) mm",
        ),
        (
            "hand sensor: {kind: overhead}\n"
            "faults:\n  - hand sensor: sees a false hand\n    at: [3 m, 0 m, 0 m]\n",
            "at: [",
            "faults[0].at",
            "a false hand where the hand sensor could see one",
            "(3000, 0, 0) mm",
        ),
        (
            "camera: {source: rendered}\nfaults:\n  - camera: is hidden by hands\n",
            "- camera",
            "faults[0]",
            "exact or raster images",
            "rendered ones",
        ),
        (
            "camera: {latency: 100 ms}\nfaults:\n  - camera: is late\n    delay: 397 ms\n",
            "delay: ",
            "faults[0].delay",
            "at most 62 pictures under way",
            "0.497 s, which is 62 pictures",
        ),
        (
            "faults:\n  - hand sensor: is late\n    delay: 300 ms\n"
            "  - hand sensor: is late\n    delay: 200 ms\n",
            "delay: 200",
            "faults[1].delay",
            "at most 62 pictures under way",
            "0.5 s",
        ),
    ],
)
def test_what_does_not_fit_together_is_refused_at_its_line(
    addition: str, at: str, field: str, expected: str, got: str
) -> None:
    base = BASE.replace("avoider: opposite pose\n", "") if "avoider" in addition else BASE
    error = refusal(base + addition)
    line = (base + addition[: addition.index(at)]).count("\n") + 1
    assert error.place == Place(file=FILE, line=line, field=field)
    assert error.expected.startswith(expected)
    assert error.got.startswith(got)


def test_the_ideal_sensor_is_told_from_those_with_faults_in_the_hint() -> None:
    assert "kind: overhead" in refusal(BASE + "hand sensor: {latency: 33 ms}\n").hint


def test_the_restart_delay_is_explained_by_what_a_stop_takes() -> None:
    hint = refusal(BASE + "settings: {avoidance: {repulsion speed: 2 m/s}}\n").hint
    assert hint == "reaction time 0.1 s, stop time base 0.35 s, stop time per speed 0.1 s2/m, fastest 2 m/s"


@pytest.mark.parametrize(
    "addition",
    [
        HAND,
        HAND.replace("5 mm", "-300 mm"),  # the centre on the table's top
        RECORDED,  # the dip comes after the run has ended
        "camera: {rate: 125 Hz}\n",
        "settings: {clock: {control period: 7 ms}}\ncamera: {rate: 142 Hz}\n",
        "hand sensor: {kind: overhead, latency: 33 ms, rate: 125 Hz, dropout: 5 %, detector: rendered}\n",
        "hand sensor: {kind: ideal, latency: 0 s, rate: every tick, dropout: 0 %, detector: exact}\n",
        "hand sensor: {kind: eye in hand, focal: 650 px}\ncamera: {focal: 650 px}\n",
        "settings: {avoidance: {repulsion speed: 2 m/s, restart delay: 650 ms}}\n",
        "settings: {cell: {table height: -350 mm}}\n",
        "camera: {latency: 100 ms}\nfaults:\n  - camera: is late\n    delay: 396 ms\n",
        "camera: {rate: 30 Hz}\nfaults:\n  - camera: is late\n    delay: 2 s\n",
        "faults: [{hand sensor: sees a false hand, at: [3 m, 0 m, 0 m]}]\n",  # the ideal one has no border
        "hand sensor: {kind: eye in hand}\nfaults: [{hand sensor: sees a false hand, at: [3 m, 0 m, 0 m]}]\n",
        f"object: {{polygon: {ARROW}}}\n",
        f"object: {{polygon: {BOW}}}\nsettings: {{servo: {{object kind: discrete}}}}\n",
    ],
)
def test_what_just_fits_is_admitted(addition: str) -> None:
    recordings = {hashlib.sha256(DIP.encode()).hexdigest(): DIP.encode()}
    admit(parse_scenario(BASE + addition, FILE, recordings))


@pytest.mark.parametrize(
    "sentence",
    ["hand distance never below 1e300 m", "TCP speed never above 11 m/s", "gain switch reached within 2 h"],
)
def test_a_limit_that_no_run_can_reach_is_refused(sentence: str) -> None:
    with pytest.raises(Exception, match=r"folder/slip\.yaml:5: claims\."):
        admit(parse_scenario(BASE.replace("gain switch reached", sentence), FILE))
