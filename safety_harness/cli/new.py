"""``safety-harness new``: a commented scenario file to start from, which runs as it is."""

from __future__ import annotations

from pathlib import Path

from safety_harness.cli.console import AS_EXPECTED, say
from safety_harness.exceptions import OutputError, Place

STARTING_FILE = """\
# A scenario: one thing to try. Every value has its unit; "safety-harness explain KEY" says what a key means.
# Run it with: safety-harness run {name}
scenario: a hand reaches past the tool and withdraws
about: >
  Say here why one would try this: what could go wrong, and what you would learn from it.
duration: 6 s
seed: 1

# Where the tool starts, as an offset from the pose that the servoing should end in.
# Positions are in the robot's base frame: x forward, y left, z up, origin at the foot of the arm.
tcp start:
  offset: [30 mm, -60 mm, 60 mm]

# What proposes where the tool gives way to: a name, FILE.py:NAME, FILE.onnx or FILE.safetensors.
avoider: mc-dropout

# At most two hands; each does one move after another, then rests.
hands:
  - hand: right hand
    starts at: [1100 mm, -750 mm, 150 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - wait: 500 ms
      - move to: [840 mm, -350 mm, 300 mm]
        speed: 0.6 m/s
      - wait: 1 s
      - withdraw: 1.6 m/s

# The camera that watches the hands, and how it errs.
hand sensor:
  kind: overhead
  rate: 30 Hz
  latency: 33 ms

# Everything else keeps its default; docs/scenario-language.md has them all.
settings:
  avoidance:
    critical distance: 400 mm

# What you claim will come of it: holds, violated or inconclusive.
claims:
  hand distance never below 50 mm: holds
  repulsive poses reachable: holds
  joint speeds within limits: holds
  the avoider answered: holds
"""


def new(file: Path) -> int:
    """Write the file, unless there is one already; returns the exit code."""
    try:
        with file.open("x", encoding="utf-8") as stream:
            stream.write(STARTING_FILE.format(name=file))
    except OSError as error:
        expected, got = "a place that can be written", error.strerror or str(error)
        if isinstance(error, FileExistsError):
            expected, got = "a file that is not there yet", "one that is"
        raise OutputError(place=Place(file=file), expected=expected, got=got) from error
    say(f"{file} is a scenario; run it with: safety-harness run {file}")
    return AS_EXPECTED
