"""Which avoider a reference means: one of ours by name, a user's own Python file, or a model file.

A Python file is the user's own program and is executed, with everything that it imports, where a scenario
that names it is run and for no other reason, and in a process of its own; so is a function in ONNX, which is
no program but may never end.  Any other model file is only read.  ``refuse_unusable`` executes nothing.
"""

from __future__ import annotations

import filecmp
import hashlib
import os
import shlex
from collections import ChainMap
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from safety_harness.base.exceptions import InadmissibleError, Place, TraceError, near_miss, refuse_other_type
from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.base.shipped.contents import is_shipped, located
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.isolation.isolated import isolated_avoider, isolated_onnx
from safety_harness.cell.avoidance.model_file import LARGEST_BYTES, refuse_foreign_cell
from safety_harness.cell.avoidance.python_file import refuse_undefined
from safety_harness.cell.avoidance.shipped import SHIPPED, shipped_model
from safety_harness.cell.avoidance.simple import NearestCandidate, OppositePose
from safety_harness.scenario.fields import SENTENCE, is_sentence
from safety_harness.scenario.files import resolved, told
from safety_harness.scenario.kinds import avoider_in, command_for, kind_of
from safety_harness.scenario.model import (
    DEFAULT_AVOIDER,
    NO_AVOIDER,
    VISUAL_SERVO,
    Driver,
    OffsetStart,
    Scenario,
)
from safety_harness.scenario.references import (
    MODEL_SUFFIX,
    ONNX_SUFFIX,
    file_and_name,
    named_from,
    names_a_program,
    names_onnx,
    with_file,
)
from safety_harness.space.regions import exported_use

if TYPE_CHECKING:
    from safety_harness.cell.avoidance.learned import LearnedAvoider


OPPOSITE, NEAREST = "opposite pose", "nearest candidate"
NAMES = (*SHIPPED, OPPOSITE, NEAREST)
FORMS = f"one of: {', '.join(NAMES)}; FILE.py:NAME; FILE{MODEL_SUFFIX}; FILE{ONNX_SUFFIX}"


@dataclass(frozen=True)
class _Wanted:
    """What an avoider that is no program is made of; ``scenario`` has the places for messages."""

    source: tuple[Path, str] | str
    settings: Settings
    scenario: Scenario = field(compare=False)


class Avoiders:
    """The avoiders that scenarios name, each made as seldom as nobody can tell.

    Of a Python file nothing depends on a scenario but the file and the name in it: it is made once, and
    keeps its memory if it has one.  The others are functions of their questions, made from their settings.
    """

    def __init__(self) -> None:
        self._programs: dict[tuple[Path, str], tuple[Avoider, str]] = {}
        self._others = lru_cache(maxsize=16)(lambda wanted: _made(wanted.scenario))

    def of(self, scenario: Scenario) -> tuple[Avoider, str]:
        """The avoider that ``scenario.avoider`` names, and its file's hash; errors as ``resolve_avoider``."""
        path, name = _file_of(scenario), file_and_name(scenario.avoider)[1]
        if path is None or not is_a_program(scenario.avoider):
            source = scenario.avoider if path is None else (path, name)
            return self._others(_Wanted(source, scenario.settings.steady, scenario))
        if (path, name) not in self._programs:
            self._programs[path, name] = _made(scenario)
        return self._programs[path, name]


def _made(scenario: Scenario) -> tuple[Avoider, str]:
    return resolve_avoider(scenario), avoider_sha256(scenario)


def resolve_avoider(scenario: Scenario, place: Place | None = None) -> Avoider:
    """The avoider that the scenario names, ready to be asked.

    A relative file is sought from the scenario's folder (without a file: the working directory).  ``place``
    is what errors name; None is where the scenario names its avoider.  InadmissibleError if there is no
    such avoider or it is none, ModelError if a model file cannot be used.
    """
    place = place or scenario.place("avoider")
    path = _found(scenario, place)
    reference, settings = scenario.avoider, scenario.settings
    if path is None:
        opposite = reference == OPPOSITE
        return OppositePose(settings.avoidance.radius_m) if opposite else NearestCandidate.for_cell(settings)
    name = file_and_name(reference)[1]
    if names_onnx(reference):
        avoider = isolated_onnx(path, settings, name)
        _refuse_foreign_onnx(path, settings)
        return avoider
    if name:
        return isolated_avoider(path, name, place)
    return _from_model_file(path, settings)


def refuse_unusable(scenario: Scenario, place: Place | None = None) -> None:
    """As ``resolve_avoider`` refuses, as far as can be seen without executing anything of a user's.

    A Python file is parsed, of an ONNX file the metadata are read; anything else is resolved.
    """
    place = place or scenario.place("avoider")
    path, name = _found(scenario, place), file_and_name(scenario.avoider)[1]
    if path is not None and names_onnx(scenario.avoider):
        _refuse_foreign_onnx(path, scenario.settings)
    elif path is not None and name:
        refuse_undefined(path, name, place)
    else:
        resolve_avoider(scenario, place)


def _found(scenario: Scenario, place: Place) -> Path | None:
    """The file of the scenario's avoider, which is there; None for one of ours without a file."""
    reference = scenario.avoider
    if reference in (OPPOSITE, NEAREST):
        return None
    path = _file_of(scenario)
    if path is None:
        raise _no_avoider(scenario, place)
    if not path.is_file():
        raise InadmissibleError(place=place, expected="a file that can be read", got=f"no such file: {path}")
    return path


def _no_avoider(scenario: Scenario, place: Place) -> InadmissibleError:
    """What is said of a reference that is neither a name nor a kind of file that avoiders come from."""
    reference = scenario.avoider
    beside = (folder_of(scenario) or Path()) / os.path.expanduser(reference)
    path = beside if beside.exists() else Path(os.path.expanduser(reference))
    kind = kind_of(path)
    got, hint = repr(reference), near_miss(reference, NAMES, most=3)
    if kind is not None:
        got, hint = f"{got}, {kind.words}", command_for(path, kind)
    if reference.endswith(".py"):
        hint = f"name the class in it as well: {reference}:{avoider_in(path)}"
    return InadmissibleError(place=place, expected=FORMS, got=got, hint=hint)


def avoider_sha256(scenario: Scenario) -> str:
    """The hash of the file that the scenario's avoider comes from; empty without a file or an avoider."""
    path = None if scenario.driven else _file_of(scenario)
    return "" if path is None else hashlib.sha256(path.read_bytes()).hexdigest()


def command_line_reference(scenario: Scenario) -> str:
    """What is tested, as one would name it on the command line, in the working directory."""
    folder = folder_of(scenario) or Path()
    return with_file(
        scenario.under_test, lambda file: file if is_shipped(file) else os.path.relpath(folder / file)
    )


def told_avoider(reference: str) -> str:
    """What is tested, as a result names it: its file is ``told``."""
    return str(with_file(reference, lambda file: str(told(Path(os.path.expanduser(file))))))


def option_of(reference: str) -> str:
    """The option of the command line that names what is tested."""
    return "--controller" if isinstance(reference, Driver) else "--avoider"


def one_of(avoider: str | None, controller: str | None) -> str | None:
    """What the options of a command name, one of which may be given; None for neither."""
    if avoider is not None and controller is not None:
        expected = "one of --avoider and --controller: only the visual servo asks an avoider"
        raise InadmissibleError.of_option("--controller", expected, "both")
    return avoider if controller is None else Driver(controller)


def reference_for(tested: str | None, reference: str | None) -> str | None:
    """What ``--against`` names beside what is ``tested``; InadmissibleError for that itself.

    It is a ``Driver`` by its name, or if it is a program, or beside another if no avoider has its name.
    """
    from safety_harness.cell.controller.named import NAMES as CONTROLLERS  # loads what few commands need

    driver = reference in CONTROLLERS or names_a_program(reference or "")
    driver |= isinstance(tested, Driver) and reference not in NAMES
    refuse_itself(tested, reference)
    return Driver(reference) if driver and reference is not None else reference


def refuse_itself(tested: str | None, reference: str | None, option: str = "--against") -> None:
    """InadmissibleError where what is tested is its own reference: the same word, or one name in one file."""
    whole = {
        (os.path.realpath(os.path.expanduser(file)), name) if file else (str(one), "")
        for one in (tested, reference)
        for file, name in [file_and_name(one or "")]
    }
    if tested is not None and len(whole) == 1:
        got = f"{reference} itself: such a comparison finds nothing"
        raise InadmissibleError.of_option(option, f"another reference than {tested}", got)


def refuse_same(tested: Scenario | None, other: Scenario, option: str = "--against") -> None:
    """InadmissibleError where the reference in a scenario's place, ``other``, is what that names already.

    Or names it otherwise: by an alias of its file, or by a copy.
    """
    if tested is not None and (tested == other or _is_copy(tested, other)):
        refuse_itself(other.under_test, other.under_test, option)


def _is_copy(tested: Scenario, other: Scenario) -> bool:
    """Have both files the same bytes?  A program in another folder may read other files than its copy."""
    first, second = (_file_of(replace(one, avoider=str(one.under_test))) for one in (tested, other))
    own, name = (file_and_name(one.under_test)[1] for one in (tested, other))
    if first is None or second is None or own != name or not (first.is_file() and second.is_file()):
        return False
    beside = first.parent == second.parent or not is_a_program(tested.under_test)
    return beside and filecmp.cmp(first, second, shallow=False)


def replay_command(
    scenario: Scenario, trace: Path, *others: Path, by: str = "replay", told: Callable[[Path], Path] = told
) -> str:
    """The command that repeats runs of one avoider or controller, of which a user's program is named anew.

    A trace may come from anybody: what it names is not executed for that.

    ``by`` is another command that repeats runs.  ``told`` names files; what is kept nowhere may name them as
    they are.
    """
    command = ["safety-harness", by, *(str(told(one)) for one in (trace, *others))]
    if is_a_program(scenario.under_test):
        reference = command_line_reference(scenario)
        named = told_avoider(os.path.abspath(reference) if file_and_name(reference)[0] else reference)
        command += [option_of(scenario.under_test), named]
    return shlex.join(command)


def with_program(
    scenario: Scenario, tested: str | None, file: Path | None = None, by: str = "replay"
) -> Scenario:
    """The scenario of a trace in ``file`` with what the user names; TraceError for a program not named anew.

    A trace may come from anybody, and repeating it, ``by`` which command, must not execute what it says.
    """
    if tested is not None:
        return with_avoider(scenario, tested)
    if is_a_program(scenario.under_test):
        option, got = option_of(scenario.under_test), f"a trace made with {scenario.under_test}"
        place = Place(file=file, field=option.removeprefix("--"))
        expected = f"the program named with {option}, since repeating the run executes it"
        hint = "" if file is None else replay_command(scenario, file, by=by)
        raise TraceError(place=place, expected=expected, got=got, hint=hint)
    return scenario


def scenario_of_avoider(reference: str) -> Scenario:
    """A scenario that has nothing but an avoider: for who makes one without a file that names it."""
    return Scenario(
        name="avoider",
        title="an avoider that is to be made",
        about="",
        duration_s=1.0,
        seed=0,
        start=OffsetStart(offset_in_base_m=(0.0, 0.0, 0.0)),
        hands=(),
        avoider=reference,
        claims=(),
    )


def shipped_avoider(name: str, settings: Settings = DEFAULTS) -> Avoider:
    """One of ours by its name, ready to be asked; InadmissibleError for a name that none has.

    To be wrapped in an ``AvoiderAround``, say.
    """
    refuse_other_type("shipped_avoider(name)", name, str, expected=f"one of: {', '.join(NAMES)}")
    if name not in NAMES:
        hint = near_miss(name, NAMES, most=3)
        raise InadmissibleError.of_option("avoider", f"one of: {', '.join(NAMES)}", repr(name), hint)
    return resolve_avoider(replace(scenario_of_avoider(name), settings=settings))


def is_a_program(reference: str) -> bool:
    """Does the reference name a Python file, or a program, which is executed to resolve it?"""
    return file_and_name(reference)[0].endswith(".py") or names_a_program(reference)


def is_executed(reference: str) -> bool:
    """Does a run with it execute a file: a program, or a function in ONNX, which may never end?"""
    return is_a_program(reference) or names_onnx(reference)


def folder_of(scenario: Scenario) -> Path | None:
    """Where the scenario's relative files are sought from; None: the working directory."""
    return scenario.file.parent if scenario.file is not None else None


def _file_of(scenario: Scenario) -> Path | None:
    """The file of the scenario's avoider, which need not be there; None for one without."""
    if scenario.avoider in SHIPPED:
        return shipped_model(scenario.avoider)
    file, _ = file_and_name(scenario.avoider)
    return resolved(located((folder_of(scenario) or Path()) / os.path.expanduser(file))) if file else None


def with_avoider(scenario: Scenario, reference: str, place: Place | None = None) -> Scenario:
    """The scenario with another avoider, or ``Driver``, a relative file sought from the working directory.

    The file is named anew as seen from the scenario's folder, so that the trace of a run says which
    avoider it was and ``replay`` finds it.  ``place`` (of ``--avoider``, say) is what errors name;
    InadmissibleError if what would be written could not be read again.
    """
    if isinstance(reference, Driver):
        return _driven_by(scenario, reference, place or Place(field="--controller"))
    place = place or Place(field="--avoider")
    if scenario.driven:
        expected = f"no avoider for a scenario that is driven by {scenario.controller}, which asks none"
        raise InadmissibleError(place=place, expected=expected, got=repr(reference))
    return replace(scenario, **_placed(scenario, "avoider", "an avoider", reference, place))


def _placed(scenario: Scenario, key: str, what: str, reference: str, place: Place) -> dict[str, Any]:
    """Return what stands below ``key`` then, and where it was named."""
    folder = resolved(folder_of(scenario) or Path())
    named = str(
        with_file(
            reference, lambda file: named_from(folder, resolved(located(os.path.expanduser(file), place)))
        )
    )
    if not is_sentence(named):
        raise InadmissibleError(place=place, expected=f"{what}'s name or file, {SENTENCE}", got=repr(named))
    return {key: named, "places": ChainMap({key: place}, scenario.places)}  # type: ignore[arg-type]  # it is only read


def _driven_by(scenario: Scenario, reference: Driver, place: Place) -> Scenario:
    """With another controller, and then without an avoider; the visual servo has its own, or the default."""
    changes = _placed(scenario, "controller", "a controller", reference, place)
    servo = changes["controller"] == VISUAL_SERVO
    return replace(scenario, avoider=scenario.avoider or DEFAULT_AVOIDER if servo else NO_AVOIDER, **changes)


def _from_model_file(path: Path, settings: Settings) -> Avoider:
    try:
        with path.open("rb") as file:
            digest = hashlib.sha256(file.read(LARGEST_BYTES + 1)).hexdigest()
    except OSError:
        digest = ""  # loading says what is wrong
    avoider = _learned(path, digest)
    refuse_foreign_cell(avoider.model, settings, path)
    return avoider


@lru_cache(maxsize=4)  # a folder of scenarios names the same one or two over and over
def _learned(path: Path, sha256: str) -> LearnedAvoider:
    from safety_harness.cell.avoidance.learned import LearnedAvoider
    from safety_harness.cell.avoidance.model_file import load_model

    return LearnedAvoider.from_model(load_model(path))


def _refuse_foreign_onnx(path: Path, settings: Settings) -> None:
    """ModelError for a file of ours that was trained for another workspace; of others nothing is known."""
    network = exported_use(path)
    if network is not None:
        refuse_foreign_cell(network, settings, path)


def as_seen_from(folder: Path, scenario: Scenario) -> Scenario:
    """The scenario with its recordings, and its avoider's file, named relative to another folder."""
    before = scenario.file.parent if scenario.file else Path()
    moved = scenario.with_files(lambda path: named_from(folder, before / path))
    moved = replace(moved, file=folder / "scenario.yaml")
    has_file = bool(file_and_name(scenario.under_test)[0])
    return with_avoider(moved, command_line_reference(scenario)) if has_file else moved


def with_system_of(like: Scenario, scenario: Scenario) -> Scenario:
    """The scenario with the avoider or the controller of ``like``, in whose folder it is then."""
    tested = [(one.driven, command_line_reference(one)) for one in (like, scenario)]
    if tested[0] == tested[1]:
        return scenario
    places = {**scenario.places, **{key: like.place(key) for key in ("avoider", "controller")}}
    moved = as_seen_from(folder_of(like) or Path(), scenario)
    return replace(moved, file=like.file, avoider=like.avoider, controller=like.controller, places=places)
