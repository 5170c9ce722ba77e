"""An avoider from a user's own Python file, which is executed, with all that it imports."""

from __future__ import annotations

import hashlib
import inspect
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import NoReturn

from safety_harness.avoidance.avoider import Avoider, decision_time_of, described, spread_threshold_of
from safety_harness.exceptions import AvoiderError, InadmissibleError, Place
from safety_harness.scenario.fields import SENTENCE, is_sentence

AVOIDER = Place(field="avoider")  # who asked for it knows the place of the reference to it
QUESTION = ("hand_position_in_base_m", "tcp_position_in_base_m", "seed")  # the keywords of propose


class PythonFile:
    """One file of a user's, and its text."""

    def __init__(self, path: Path, source: bytes) -> None:
        self._path = path
        self._source = source

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
            exec(compile(self._source, str(self._path), "exec"), module.__dict__)
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
        for read, attribute, kind in (
            (spread_threshold_of, "spread_threshold_m", "a length"),
            (decision_time_of, "decision_time_s", "a time"),
        ):
            try:
                read(avoider)
            except AvoiderError as error:
                self._refuse(f"{name} to have a {attribute} that is {kind}, or none", str(error))
            except Exception as error:  # a user's property
                self._raised(f"{name} to have a {attribute} that can be read", error)
        return avoider

    def _raised(self, expected: str, error: BaseException) -> NoReturn:
        raise InadmissibleError(
            place=AVOIDER, expected=expected, got=described(error, str(self._path))
        ) from error

    def _refuse(self, expected: str, got: str) -> NoReturn:
        raise InadmissibleError(place=AVOIDER, expected=expected, got=got, hint="see docs/avoiders.md")
