"""Define ``safety-harness warm``, which compiles the machine code of runs and judgements in advance."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from types import FunctionType

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_many, run_trial
from safety_harness.base.compiled import cache_root, compilation, forget_old_machine_code, machine_code
from safety_harness.base.exceptions import InstallationError
from safety_harness.base.extension_points import ExtensionPoint, loaded
from safety_harness.cell.simulation.worlds import KINEMATIC, WORLDS, WorldEntry
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.cli.console import AS_EXPECTED, DIFFERS, document, result, say
from safety_harness.report.run_job import run
from safety_harness.scenario.read import parse_scenario

# A hand comes so near that the tool gives way; the first claim of the catalogue is known to hold.
SHORT_RUN = """
scenario: one short run of each part
duration: 2 s
seed: 1
tcp start:
  offset: [30 mm, -60 mm, 60 mm]
avoider: mc-dropout
hands:
  - hand: right hand
    starts at: [1000 mm, -550 mm, 250 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - move to: [840 mm, -350 mm, 300 mm]
        speed: 1 m/s
      - withdraw: 1.6 m/s
claims:
  trace finite and monotone: holds
"""
WITH_A_SENSOR = """
hand sensor:
  kind: overhead
  rate: 30 Hz
  latency: 33 ms
"""


def warm_up() -> int:
    """Run and judge short scenarios in every installed world, report the cache, and return the exit code."""
    worlds = list(_installed_worlds())
    for text in (SHORT_RUN, SHORT_RUN + WITH_A_SENSOR):
        admitted = admit(parse_scenario(text))
        for world in worlds:
            trace = run_trial(admitted, world=world)
            for entry in CATALOGUE:
                entry.prop.evaluate(trace)
        list(run_many([admitted], world=KINEMATIC))
    with tempfile.TemporaryDirectory() as folder:
        for world in worlds:  # what a run checks beside its claims, and what its page draws
            run(parse_scenario(SHORT_RUN), world=world).write(folder)
    for _, make in loaded(ExtensionPoint.WARMING, FunctionType):
        make()
    return _report_cache()


def _installed_worlds() -> Iterator[WorldEntry]:
    """Yield the worlds whose engine is installed, and report the engines that are missing."""
    for world in WORLDS:
        try:
            world.opener()
        except InstallationError as error:
            say(f"not for {error}")
        else:
            yield world


def forget_old() -> int:
    """Remove the machine code that is no longer used, report its size, and return the exit code."""
    size = machine_code_bytes()
    count = forget_old_machine_code()
    freed = size - machine_code_bytes()
    document(folder=cache_root(), removed_folders=count, removed_bytes=freed)
    result(f"{count} folders removed, {megabytes(freed)}; {megabytes(size - freed)} left in {cache_root()}")
    return AS_EXPECTED


def _report_cache() -> int:
    came, kept = compilation(), machine_code_bytes()
    document(
        folder=cache_root(),
        bytes=kept,
        functions=came.ready,
        compiling_s=came.seconds,
        problem=came.unwritable or None,
    )
    if came.unwritable and (came.seconds or not kept):
        say(f"error: {came.unwritable}")
        return DIFFERS
    new = f"compiled in {came.seconds:.0f} s" if came.seconds else "all of them there already"
    result(f"machine code of {came.ready} functions, {new}: {megabytes(kept)} in {cache_root()}")
    return AS_EXPECTED


def machine_code_bytes() -> int:
    """Return the size [byte] of all stored machine code, including the code of other versions."""
    return sum(file.stat().st_size for folder in machine_code() for file in folder.rglob("*.nb?"))


def megabytes(size: int) -> str:
    """Return a size [byte] as text such as ``12.3 MB``."""
    return f"{size / 1e6:.1f} MB"
