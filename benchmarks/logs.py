"""Judging logs.  Run: python benchmarks/logs.py [verdicts|bag|recordings]: each prints a table.

``verdicts``: N synthetic logs whose truth is known (``tests/field/logs``), judged by claims whose thresholds
lie within 150 mm of the truth.  ``bag``: a ROS 2 bag of so many GB, most of it pictures, and the memory that
judging it takes.  ``recordings``: the six recorded hands beside the logged joints of a simulated arm, as
their scenarios place them.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests" / "field" / "logs")]

from safety_harness.admission.admit import admit  # noqa: E402
from safety_harness.admission.trial import judge, run_kinematic  # noqa: E402
from safety_harness.base.exceptions import LogError  # noqa: E402
from safety_harness.cell.robot.robots import arm_model  # noqa: E402
from safety_harness.extensions.field.logs.judging import recorded  # noqa: E402
from safety_harness.scenario.model import RecordedHand, Verdict  # noqa: E402
from safety_harness.scenario.read import read_scenario  # noqa: E402
from safety_harness.trace.trace import Trace  # noqa: E402

JUDGED = """
import resource, sys
from safety_harness.cli.replay import judge_again
from pathlib import Path
assert judge_again([Path(sys.argv[1])]) in (0, 1)
print("peak memory, MB:", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
"""
RECORDINGS = (
    "recorded-handover",
    "recorded-handover-two-hands",
    "recorded-giving",
    "recorded-hammering",
    "recorded-inspection",
    "recorded-pick-and-place",
)


def verdicts(count: int) -> None:
    """How many verdicts are false, and how many are given where they should be."""
    from truths import judged_logs

    counts: dict[str, Counter[str]] = {}
    false, began = 0, time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(count):
            for one in judged_logs(seed, Path(folder)):
                kind = one.sentence.rstrip("0123456789. m")
                found = counts.setdefault(kind, Counter())
                found.update(["claims", one.found.verdict.value])
                found.update(["false"] * one.false + ["clear"] * one.clear)
                found.update(["decided"] * (one.clear and one.decided))
                found.update(["idle"] * (one.clear and one.found.reason.startswith("never exercised")))
                if one.false:
                    false += 1
                    print(f"FALSE: seed {seed}: {one}", file=sys.stderr)
    print(f"{count:,} logs in {time.perf_counter() - began:.0f} s, {false} false verdicts.\n")
    in_order = [verdict.value for verdict in _IN_ORDER]
    heads = ["claim", "claims", *in_order, "false", "clear", "decided of these", "never exercised"]
    print(f"| {' | '.join(heads)} |")
    print("|---" * len(heads) + "|")
    for kind, n in counts.items():
        share = f" ({n['decided'] / n['clear']:.1%})" if n["clear"] else ""
        cells = (
            *(n[key] for key in ("claims", *(v.value for v in _IN_ORDER), "false", "clear")),
            f"{n['decided']}{share}",
            n["idle"],
        )
        print("| " + " | ".join(map(str, (kind, *cells))) + " |")


_IN_ORDER = (Verdict.HOLDS, Verdict.VIOLATED, Verdict.INCONCLUSIVE)


def bag(gigabytes: float, folder: Path) -> None:
    """Write a bag of pictures, joints and hands, and judge it in a process of its own."""
    from cells import cell, said
    from cells import recorded as streams_of
    from log_formats import STORE, header, joint_messages, of, poses
    from rosbags.rosbag2 import StoragePlugin, Writer

    rng = np.random.default_rng(11)
    seconds = gigabytes * 1e9 / (30 * 640 * 480 * 3)
    streams = streams_of(cell(rng), rng, seconds=seconds)
    picture = rng.integers(0, 256, 640 * 480 * 3, dtype=np.uint8)
    kind = "sensor_msgs/msg/Image"
    for storage in (StoragePlugin.SQLITE3, StoragePlugin.MCAP):
        run = folder / storage.name.lower()
        with Writer(run, version=9, storage_plugin=storage) as out:
            topics = {"/camera": out.add_connection("/camera", kind, typestore=STORE)}
            messages = joint_messages(streams) + poses(streams)
            shots = ((t, "/camera", kind, None) for t in streams.hand_ns.tolist())
            for at_ns, topic, form, message in sorted([*messages, *shots], key=lambda one: one[0]):
                if topic not in topics:
                    topics[topic] = out.add_connection(topic, form, typestore=STORE)
                if message is None:
                    message = of(kind, header(at_ns, "camera"), 480, 640, "rgb8", 0, 1920, picture)
                out.write(topics[topic], at_ns, STORE.serialize_cdr(message, form))
        size = sum(one.stat().st_size for one in run.iterdir())
        log = folder / f"{run.name}.yaml"
        log.write_text(said(f"{run.name}#/joint_states", f"{run.name}#/hand", f"{run.name}#/elbow", ""))
        began = time.perf_counter()
        judging = subprocess.run(
            [sys.executable, "-c", JUDGED, str(log)], capture_output=True, text=True, check=True
        )
        took, peak = time.perf_counter() - began, judging.stdout.split()[-1]
        print(f"| {run.name} | {size / 1e9:.2f} | {len(streams.joint_ns):,} | {took:.0f} | {peak} |")
        sys.stdout.flush()
        for one in run.iterdir():
            one.unlink()


def recordings(folder: Path) -> None:
    """Each recorded hand, unmended, as its scenario places it, beside the joints of the simulated arm."""
    print(
        "| scenario | hand | samples blanked | simulated, mm | recorded | certain margin, mm | within, mm |"
    )
    print("|---|---|---|---|---|---|---|")
    for name in RECORDINGS:
        trace = run_kinematic(admit(read_scenario(ROOT / "scenarios" / f"{name}.yaml")))
        _write_joints(trace, folder / "joints.csv")
        for number, hand in enumerate(trace.scenario.hands):
            assert isinstance(hand, RecordedHand)
            rows = write_log(trace, hand, folder)
            blanked = _blanked(folder, rows)
            log = recorded(folder / "LOG.yaml")
            (found,) = judge(log.trace)
            simulated = trace.ticks["hand_distance_m"][:, number].min() * 1e3 - 50.0
            margin = "" if found.margin is None else f"{found.margin * 1e3:+.1f}"
            why = found.reason if found.verdict is Verdict.INCONCLUSIVE else ""
            within = log.trace.known.column("hand_distance_m").uncertainty * 1e3
            print(
                f"| {name} | {hand.name} | {blanked} | {simulated:+.1f} | {found.verdict.value} | "
                f"{margin or why.partition('; by what')[0]} | {within:.1f} |"
            )


def write_log(trace: Trace, hand: RecordedHand, folder: Path) -> list[str]:
    """LOG.yaml of one recorded hand, placed as its scenario places it; returns the lines of the recording."""
    raw = ROOT / "scenarios" / hand.recording
    track = hand.name.replace(" ", "_")
    rows = raw.read_text().splitlines()
    at = [rows[0].split(",").index(f"{track}_{axis}_m") for axis in "xyz"]
    first = np.array([float(rows[1].split(",")[k]) for k in at])
    shift = np.array(hand.starts_at_in_base_m) - first
    text = (
        "log: {joints: joints.csv, hands: {HAND: hands.csv#TRACK}}\n"
        "clock: {hands are ahead by: 0 ms, known to: 2 ms}\n"
        "joints: {known to: 0.01 mrad, accelerate at most: 20 rad/s2}\n"
        "hands:\n  forearm: FOREARM\n  longest gap: 200 ms\n  moves at most: 3 m/s\n"
        "  known to: 1 mm\n  left out: [OTHERS]\n"
        f"  frame: {{at: [{', '.join(f'{x * 1e3:.4f} mm' for x in shift)}]}}\n"
        f"robot: {trace.scenario.robot.label}\nclaims: [hand distance never below 50 mm]\n"
    )
    elbow = "hands.csv#right_elbow" if track == "right_hand" else "not measured"
    tracks = [name.removesuffix("_x_m") for name in rows[0].split(",") if name.endswith("_x_m")]
    others = [f"hands.csv#{name}" for name in tracks if name not in (track, elbow.partition("#")[2])]
    text = text.replace("OTHERS", ", ".join(others)) if others else text.replace("  left out: [OTHERS]\n", "")
    text = text.replace("HAND", hand.name).replace("TRACK", track).replace("FOREARM", elbow)
    (folder / "LOG.yaml").write_text(text)
    return rows


def _write_joints(trace: Trace, file: Path) -> None:
    names = arm_model(trace.scenario.robot).joint_names
    lines = ["time_ns," + ",".join(f"{name}_rad" for name in names)]
    for time_s, row in zip(trace.time_s, trace.ticks["joint_position_rad"], strict=True):
        lines.append(f"{round(time_s * 1e9)}," + ",".join(repr(float(angle)) for angle in row))
    file.write_text("\n".join(lines) + "\n")


def _blanked(folder: Path, rows: list[str]) -> int:
    """Leave out, as its owner would, each sample that is refused as another marker's; how many there were."""
    rows, width = list(rows), rows[0].count(",")
    for blanked in range(1000):
        (folder / "hands.csv").write_text("\n".join(rows) + "\n")
        try:
            recorded(folder / "LOG.yaml")
        except LogError as error:
            if error.place.line is None:
                raise
            line = error.place.line - 1
            rows[line] = rows[line].split(",")[0] + "," * width
        else:
            return blanked
    raise RuntimeError("more than a thousand samples are refused")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    sections = ("verdicts", "bag", "recordings")
    parser.add_argument("sections", nargs="*", default=sections, metavar="SECTION")
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--gigabytes", type=float, default=2.0)
    given = parser.parse_args()
    if not set(given.sections) <= set(sections):
        parser.error(f"SECTION: some of {', '.join(sections)}")
    for section in given.sections:
        with tempfile.TemporaryDirectory() as folder:
            if section == "verdicts":
                verdicts(given.count)
            elif section == "bag":
                print("| bag | GB | joint samples | seconds | peak memory, MB |\n|---|---|---|---|---|")
                bag(given.gigabytes, Path(folder))
            else:
                recordings(Path(folder))
