"""Which avoider a reference means: one of ours by name, a user's own Python file, or a model file.

A Python file is the user's own program and is executed, with everything that it imports, because a
reference names it and for no other reason.  A model file is only read.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import sys
from dataclasses import replace
from difflib import get_close_matches
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import NoReturn

from safety_harness.avoidance.avoider import Avoider, described, spread_threshold_of
from safety_harness.avoidance.nearest_candidate import NearestCandidate
from safety_harness.avoidance.opposite import OppositePose
from safety_harness.exceptions import AvoiderError, InadmissibleError, Place
from safety_harness.scenario.fields import SENTENCE, is_sentence
from safety_harness.scenario.model import Scenario
from safety_harness.settings import Settings

NAMES = ("opposite pose", "nearest candidate")
MODEL_SUFFIX = ".safetensors"
QUESTION = ("hand_position_in_base_m", "tcp_position_in_base_m", "seed")  # the keywords of propose
FORMS = f"one of: {', '.join(NAMES)}; FILE.py:NAME; FILE{MODEL_SUFFIX}"


def avoider_of(scenario: Scenario) -> Avoider:
    """The avoider that ``scenario.avoider`` names, a file relative to the scenario's own folder."""
    folder = scenario.file.parent if scenario.file is not None else None
    return resolve_avoider(scenario.avoider, scenario, folder=folder)


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
    if reference.endswith(MODEL_SUFFIX):
        return _from_model_file(_file(reference, folder, place), scenario.settings)
    file, separator, name = reference.rpartition(":")
    if separator and file.endswith(".py"):
        return _PythonFile(_file(file, folder, place), place).avoider(name)
    near = get_close_matches(reference, NAMES, n=1)
    hint = f"did you mean {near[0]!r}?" if near else ""
    if reference.endswith(".py"):
        hint = f"name the class in it as well: {reference}:NAME"
    raise InadmissibleError(place=place, expected=FORMS, got=repr(reference), hint=hint)


def with_avoider(scenario: Scenario, reference: str, place: Place | None = None) -> Scenario:
    """The scenario with another avoider, a relative file sought from the working directory.

    The file is named anew as seen from the scenario's folder, so that the trace of a run says which
    avoider it was and ``replay`` finds it.  ``place`` (of ``--avoider``, say) is what errors name;
    InadmissibleError if what would be written could not be read again.
    """
    place = place or Place(field="--avoider")
    file, colon, name = reference.rpartition(":") if ".py:" in reference else (reference, "", "")
    if file.endswith((".py", MODEL_SUFFIX)):
        folder = scenario.file.parent if scenario.file is not None else Path()
        path = Path(file).expanduser().resolve()
        reference = os.path.relpath(path, folder.resolve()) + colon + name
    if not is_sentence(reference):
        raise InadmissibleError(
            place=place, expected=f"an avoider's name or file, {SENTENCE}", got=repr(reference)
        )
    return replace(scenario, avoider=reference, places=scenario.places | {"avoider": place})


def _file(reference: str, folder: Path | None, place: Place) -> Path:
    path = (folder or Path()) / Path(reference).expanduser()
    if path.is_file():
        return path.resolve()
    raise InadmissibleError(place=place, expected="a file that can be read", got=f"no such file: {path}")


def _from_model_file(path: Path, settings: Settings) -> Avoider:
    """Imported only here: a run with another avoider need not wait for it."""
    from safety_harness.avoidance.learned import LearnedAvoider
    from safety_harness.avoidance.model_file import load_model, refuse_foreign_seen_space

    model = load_model(path)
    refuse_foreign_seen_space(model, settings, path)
    return LearnedAvoider.of(model)


class _PythonFile:
    """One file of a user's; every failure names the place of the reference to it."""

    def __init__(self, path: Path, place: Place) -> None:
        self._path = path
        self._place = place

    def avoider(self, name: str) -> Avoider:
        """The avoider called ``name``: an object, or an instance of a class without required arguments."""
        found = getattr(self._module(), name, None)
        if found is None:
            self._refuse(f"something called {name!r} in {self._path.name}", "nothing of that name")
        if isinstance(found, type):
            try:
                found = found()
            except (Exception, SystemExit) as error:  # a user's code may raise anything
                self._raised(f"{name}() to make an avoider without any arguments", error)
        return self._admissible(found, name)

    def _module(self) -> ModuleType:
        """The file, executed afresh; its name is its own, so that it hides no module and none hides it.

        Compiled from its text: Python's own cache takes an edit within a second for none.
        """
        digest = hashlib.sha256(str(self._path).encode()).hexdigest()[:12]
        spec = spec_from_file_location(f"avoider_{digest}_{self._path.stem}", self._path)
        assert spec is not None  # of a file that ends in .py
        module = module_from_spec(spec)
        sys.modules[module.__name__] = module  # dataclasses look their module up
        try:
            exec(compile(self._path.read_bytes(), str(self._path), "exec"), module.__dict__)
        except (Exception, SystemExit) as error:  # a user's code may raise anything
            sys.modules.pop(module.__name__, None)
            self._raised(f"{self._path.name} to be a Python file that can be imported", error)
        return module

    def _admissible(self, found: object, name: str) -> Avoider:
        """``found`` if it has what an avoider needs."""
        try:
            propose, called = getattr(found, "propose", None), getattr(found, "name", None)
        except Exception as error:  # a user's property
            self._raised(f"{name} to have a name and a propose", error)
        if not callable(propose):
            self._refuse(f"{name} to have a method propose", f"none in a {type(found).__name__}")
        asked = f"propose(*, {', '.join(QUESTION)})"
        try:
            signature = inspect.signature(propose)
            signature.bind(**dict.fromkeys(QUESTION))
        except TypeError:
            self._refuse(f"{name} to have {asked}", f"propose{signature}")
        except ValueError:
            pass  # a function that is not written in Python does not tell
        if not isinstance(called, str) or not is_sentence(called):
            self._refuse(f"{name} to have a name, {SENTENCE}", repr(called))
        avoider: Avoider = found  # type: ignore[assignment]  # as has just been looked at
        try:
            spread_threshold_of(avoider)
        except AvoiderError as error:
            self._refuse(f"{name} to have a spread_threshold_m that is a length, or none", str(error))
        except Exception as error:  # a user's property
            self._raised(f"{name} to have a spread_threshold_m that can be read", error)
        return avoider

    def _raised(self, expected: str, error: BaseException) -> NoReturn:
        raise InadmissibleError(
            place=self._place, expected=expected, got=described(error, str(self._path))
        ) from error

    def _refuse(self, expected: str, got: str) -> NoReturn:
        raise InadmissibleError(place=self._place, expected=expected, got=got, hint="see docs/avoiders.md")
