"""What the six recorded people did.  Run: python benchmarks/hands.py [--out FILE]: prints what was fitted.

Each recorded hand as its scenario places it, beside the joints of the simulated arm, as ``logs.py`` has it.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import tempfile
from pathlib import Path

import numpy as np
from logs import RECORDINGS, ROOT, _blanked, _write_joints, write_log

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.extensions.field.fitting import NORMAL, fit
from safety_harness.extensions.field.hands import direction_line, fit_hands, quantity_lines, space_text
from safety_harness.extensions.field.logs.read import read_log
from safety_harness.scenario.model import RecordedHand
from safety_harness.scenario.read import read_scenario


def logs_of_recordings(folder: Path) -> list[Path]:
    """A LOG.yaml of each recorded hand, in a folder of its own."""
    found = []
    for name in RECORDINGS:
        trace = run_kinematic(admit(read_scenario(ROOT / "scenarios" / f"{name}.yaml")))
        for number, hand in enumerate(trace.scenario.hands):
            assert isinstance(hand, RecordedHand)
            own = folder / f"{name}-{number}"
            own.mkdir()
            _write_joints(trace, own / "joints.csv")
            _blanked(own, write_log(trace, hand, own))
            found.append(own / "LOG.yaml")
    return found


def trial(count: int = 400, values: int = 40) -> None:
    """How often the right family is rejected, the wrong one too, and an interval has the true mean."""
    true, rejected, has = np.array([[0.6, 0.2]]), {"normal": 0, "uniform": 0}, 0
    for seed in range(count):
        rng = np.random.default_rng(seed)
        drawn = NORMAL.values(rng.random((1, values)), true, 0.1, 2.0)[0]
        for one in fit(drawn, low=0.1, high=2.0, rng=rng):
            rejected[one.family] += one.rejected
            if one.family == "normal":
                low, high = one.intervals["mean"]
                has += low <= true[0, 0] <= high
    print(f"{count} samples of {values} values, normal 0.6 +- 0.2 from 0.1 to 2: rejected {rejected},")
    print(f"true mean within its interval in {has}")


def main(out: Path | None) -> None:
    """Fit them, and write the space."""
    with tempfile.TemporaryDirectory() as name:
        found = fit_hands([read_log(log) for log in logs_of_recordings(Path(name))], seed=0)
    low, high = found.per_hour_interval
    minutes, rate = (
        f"{found.hours * 60.0:.2f} min of hands",
        f"{found.per_hour:.0f} ({low:.0f} to {high:.0f})",
    )
    print(f"{found.approaches} approaches in {minutes}: {rate} an hour\n")
    for one in found.quantities:
        print(*quantity_lines(one), sep="\n")
    print(direction_line(found.direction), *found.notes, sep="\n")
    if out is not None:
        out.write_text(space_text(found))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    main(parser.parse_args().out)
    trial()
