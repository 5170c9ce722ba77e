"""Runs in the kinematic world with a program that breaks when it is told to."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from examples import scenario

from safety_harness.admission.admit import Admitter
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.exceptions import ControllerError
from safety_harness.scenario.model import NO_AVOIDER
from safety_harness.trace.compare import first_difference
from tests.cell.controller.out_of_process.programs import program

WALL_LIMIT_S = 0.5
TICKS = 5


class BrokenProgram:
    """A program that misbehaves in one way at tick 3 while a file is there."""

    def __init__(self, folder: Path, way: str) -> None:
        plain = scenario(duration_s=TICKS * 0.008)
        clock = replace(plain.settings.clock, wall_limit_s=WALL_LIMIT_S)
        settings = replace(plain.settings, clock=clock)
        self._break = folder / "break"
        reference = program(folder, way, self._break)
        driven = replace(plain, settings=settings, controller=reference, avoider=NO_AVOIDER)
        self.admitted = Admitter().admit(driven)
        self._undisturbed = run_kinematic(self.admitted)

    def episode(self, told: bytes) -> str:
        """Why an episode in which it breaks failed, empty if it did not; the next one is as if nothing was.

        ``told`` is what it says then, if its way is to say that.
        """
        self._break.write_bytes(told)
        try:
            assert len(run_kinematic(self.admitted).ticks) == TICKS + 1
            why = ""
        except ControllerError as error:
            why = str(error)
        os.remove(self._break)
        assert first_difference(self._undisturbed, run_kinematic(self.admitted)) is None, (told[:200], why)
        return why
