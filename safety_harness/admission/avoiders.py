"""Which avoider a reference means: one of ours by name, a user's own Python file, or a model file.

A Python file is the user's own program and is executed, with everything that it imports, because a
reference names it and for no other reason, and in a process of its own; so is a function in ONNX, which is
no program but may never end.  Any other model file is only read.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import replace
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from safety_harness.avoidance.avoider import Avoider
from safety_harness.avoidance.isolation.python_program import isolated_avoider
from safety_harness.avoidance.nearest_candidate import NearestCandidate
from safety_harness.avoidance.opposite import OppositePose
from safety_harness.avoidance.shipped import SHIPPED, shipped_model
from safety_harness.exceptions import InadmissibleError, Place
from safety_harness.scenario.fields import SENTENCE, is_sentence
from safety_harness.scenario.files import resolved
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.references import MODEL_SUFFIX, ONNX_SUFFIX, file_and_name
from safety_harness.settings import Settings

if TYPE_CHECKING:
    from safety_harness.avoidance.learned import LearnedAvoider

NAMES = (*SHIPPED, "opposite pose", "nearest candidate")
FORMS = f"one of: {', '.join(NAMES)}; FILE.py:NAME; FILE{MODEL_SUFFIX}; FILE{ONNX_SUFFIX}"


def avoider_of(scenario: Scenario) -> Avoider:
    """The avoider that ``scenario.avoider`` names, a file relative to the scenario's own folder."""
    return resolve_avoider(scenario.avoider, scenario, folder=_folder_of(scenario))


def resolve_avoider(
    reference: str, scenario: Scenario, *, folder: Path | None, place: Place | None = None
) -> Avoider:
    """The avoider that ``reference`` means, ready to be asked.

    A relative file is sought from ``folder`` (None: the working directory).  ``place`` is what
    errors name; None is where the scenario names its avoider.  InadmissibleError if there is no
    such avoider or it is none, ModelError if a model file cannot be used.
    """
    place = place or scenario.place("avoider")
    if reference == "opposite pose":
        return OppositePose(scenario.settings.avoidance.radius_m)
    if reference == "nearest candidate":
        return NearestCandidate.of(scenario.settings)
    path = _file_of(reference, folder)
    if path is None:
        near = get_close_matches(reference, NAMES, n=1)
        hint = f"did you mean {near[0]!r}?" if near else ""
        if reference.endswith(".py"):
            hint = f"name the class in it as well: {reference}:NAME"
        raise InadmissibleError(place=place, expected=FORMS, got=repr(reference), hint=hint)
    if not path.is_file():
        raise InadmissibleError(place=place, expected="a file that can be read", got=f"no such file: {path}")
    if path.suffix == MODEL_SUFFIX:
        return _from_model_file(path, scenario.settings)
    if path.suffix == ONNX_SUFFIX:
        return _from_onnx_file(path, scenario.settings)
    return isolated_avoider(path, file_and_name(reference)[1], place)


def avoider_sha256(scenario: Scenario) -> str:
    """The hash of the file that the scenario's avoider comes from; empty for one without a file."""
    path = _file_of(scenario.avoider, _folder_of(scenario))
    return "" if path is None else hashlib.sha256(path.read_bytes()).hexdigest()


def command_line_reference(scenario: Scenario) -> str:
    """The scenario's avoider as one would name it on the command line, in the working directory."""
    file, name = file_and_name(scenario.avoider)
    if not file:
        return scenario.avoider
    return os.path.relpath((_folder_of(scenario) or Path()) / file) + (f":{name}" if name else "")


def is_a_program(reference: str) -> bool:
    """Does the reference name a Python file, which is executed to resolve it?"""
    return bool(file_and_name(reference)[1])


def _folder_of(scenario: Scenario) -> Path | None:
    return scenario.file.parent if scenario.file is not None else None


def _file_of(reference: str, folder: Path | None) -> Path | None:
    """The file that a reference means, which need not be there; None if it means none."""
    if reference in SHIPPED:
        return shipped_model(reference)
    file, _ = file_and_name(reference)
    return resolved((folder or Path()) / os.path.expanduser(file)) if file else None


def with_avoider(scenario: Scenario, reference: str, place: Place | None = None) -> Scenario:
    """The scenario with another avoider, a relative file sought from the working directory.

    The file is named anew as seen from the scenario's folder, so that the trace of a run says which
    avoider it was and ``replay`` finds it.  ``place`` (of ``--avoider``, say) is what errors name;
    InadmissibleError if what would be written could not be read again.
    """
    place = place or Place(field="--avoider")
    file, name = file_and_name(reference)
    if file:
        path = resolved(Path(os.path.expanduser(file)))
        reference = os.path.relpath(path, resolved(_folder_of(scenario) or Path()))
        reference += f":{name}" if name else ""
    if not is_sentence(reference):
        raise InadmissibleError(
            place=place, expected=f"an avoider's name or file, {SENTENCE}", got=repr(reference)
        )
    return replace(scenario, avoider=reference, places={**scenario.places, "avoider": place})


def _from_model_file(path: Path, settings: Settings) -> Avoider:
    """Imported only here: a run with another avoider need not wait for it."""
    from safety_harness.avoidance.model_file import LARGEST_BYTES, refuse_foreign_seen_space

    try:
        with path.open("rb") as file:
            digest = hashlib.sha256(file.read(LARGEST_BYTES + 1)).hexdigest()
    except OSError:
        digest = ""  # loading says what is wrong
    avoider = _learned(path, digest)
    refuse_foreign_seen_space(avoider.model.seen, settings, path)
    return avoider


@lru_cache(maxsize=4)  # a folder of scenarios names the same one or two over and over
def _learned(path: Path, sha256: str) -> LearnedAvoider:
    from safety_harness.avoidance.learned import LearnedAvoider
    from safety_harness.avoidance.model_file import load_model

    return LearnedAvoider.of(load_model(path))


def _from_onnx_file(path: Path, settings: Settings) -> Avoider:
    """Imported only here: a run with another avoider need not wait for it."""
    from safety_harness.avoidance.isolation.onnx_file import isolated_onnx
    from safety_harness.avoidance.model_file import refuse_foreign_seen_space

    avoider, seen = isolated_onnx(path, settings)
    if seen is not None:
        refuse_foreign_seen_space(seen, settings, path)
    return avoider
