"""References to avoiders: the name of a shipped avoider, a user's Python file, or a model file.

A Python file is the user's own program.  It is executed, with all its imports, only when a scenario that
refers to it runs, and in a separate process.  An ONNX file also gets a separate process, because its
evaluation may never end.  Any other model file is only read.  ``refuse_unusable`` executes no user code.
"""

from __future__ import annotations

import hashlib
import os
import shlex
from collections import ChainMap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from safety_harness.base.exceptions import InadmissibleError, Place, TraceError, near_miss, refuse_other_type
from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.base.shipped.contents import is_shipped, located
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.model_file import LARGEST_BYTES, refuse_foreign_cell
from safety_harness.cell.avoidance.shipped import SHIPPED, shipped_model
from safety_harness.cell.avoidance.simple import NearestCandidate, OppositePose
from safety_harness.cell.simulation.worlds import world_option
from safety_harness.scenario.fields import SENTENCE, is_sentence
from safety_harness.scenario.files import display_path, resolved
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
# The options that name the parts of a trace beside its avoider or controller, by field of the scenario.
BESIDE = {"safety_filter": "--safety-filter", "predictor": "--predictor"}
FORMS = f"one of: {', '.join(NAMES)}; FILE.py:NAME; FILE{MODEL_SUFFIX}; FILE{ONNX_SUFFIX}"


@dataclass(frozen=True)
class _Wanted:
    """The data that determine an avoider, unless the avoider is a program.

    ``scenario`` is used only to state places in error messages.
    """

    source: tuple[Path, str] | str
    settings: Settings
    scenario: Scenario = field(compare=False)


class Avoiders:
    """The avoiders of scenarios; scenarios share one avoider object wherever this changes no result.

    An avoider in a Python file depends only on the file and on the name of the object in that file, so all
    runs share one object. If that object stores data in memory, the data remain from one run to the next.
    Every other avoider is a pure function of its input, and depends on the settings.
    """

    def __init__(self) -> None:
        self._programs: dict[tuple[Path, str], tuple[Avoider, str]] = {}
        self._functions = lru_cache(maxsize=16)(lambda wanted: _made(wanted.scenario))

    def avoider_for(self, scenario: Scenario) -> tuple[Avoider, str]:
        """Return the scenario's avoider and the hash of the avoider's file.

        The method raises the same errors as ``resolve_avoider``.
        """
        path, name = avoider_file_of(scenario), file_and_name(scenario.avoider)[1]
        if path is None or not is_a_program(scenario.avoider):
            source = scenario.avoider if path is None else (path, name)
            return self._functions(_Wanted(source, scenario.settings.steady, scenario))
        if (path, name) not in self._programs:
            self._programs[path, name] = _made(scenario)
        return self._programs[path, name]

    def forget_programs(self) -> None:
        """Forget the avoiders that may remember earlier runs."""
        self._programs.clear()


def _made(scenario: Scenario) -> tuple[Avoider, str]:
    """Return a new avoider and the hash of its file."""
    return resolve_avoider(scenario), avoider_sha256(scenario)


def resolve_avoider(scenario: Scenario, place: Place | None = None) -> Avoider:
    """Return the scenario's avoider as an object that can be queried.

    Args:
        scenario: The scenario.  Relative paths start from the folder of its file, or from the working
            directory if it has no file.
        place: The place to state in error messages. None means the place where the scenario refers to its
            avoider.

    Raises:
        InadmissibleError: The avoider does not exist, or its reference leads to an object that is no avoider.
        ModelError: A model file cannot be used.

    """
    place = place or scenario.place("avoider")
    path = _existing_file(scenario, place)
    reference, settings = scenario.avoider, scenario.settings
    if path is None:
        opposite = reference == OPPOSITE
        return OppositePose(settings.avoidance.radius_m) if opposite else NearestCandidate.for_cell(settings)
    name = file_and_name(reference)[1]
    if names_onnx(reference):
        from safety_harness.cell.avoidance.isolation.isolated import isolated_onnx

        avoider = isolated_onnx(path, settings, name)
        _refuse_foreign_onnx(path, settings)
        return avoider
    if name:
        from safety_harness.cell.avoidance.isolation.isolated import isolated_avoider

        return isolated_avoider(path, name, place)
    return _from_model_file(path, settings)


def refuse_unusable(scenario: Scenario, place: Place | None = None) -> None:
    """Raise those errors of ``resolve_avoider`` that can be detected without executing user code.

    The function parses a Python file, and reads only the metadata of an ONNX file. For any other avoider, the
    function calls ``resolve_avoider``.
    """
    place = place or scenario.place("avoider")
    path, name = _existing_file(scenario, place), file_and_name(scenario.avoider)[1]
    if path is not None and names_onnx(scenario.avoider):
        _refuse_foreign_onnx(path, scenario.settings)
    elif path is not None and name:
        from safety_harness.cell.avoidance.python_file import refuse_undefined

        refuse_undefined(path, name, place)
    else:
        resolve_avoider(scenario, place)


def _existing_file(scenario: Scenario, place: Place) -> Path | None:
    """Return the existing file of the scenario's avoider, or None for a shipped avoider without a file."""
    reference = scenario.avoider
    if reference in (OPPOSITE, NEAREST):
        return None
    path = avoider_file_of(scenario)
    if path is None:
        raise _no_avoider(scenario, place)
    if not path.is_file():
        raise InadmissibleError(place=place, expected="a file that can be read", got=f"no such file: {path}")
    return path


def _no_avoider(scenario: Scenario, place: Place) -> InadmissibleError:
    """Return the error for a reference that is neither a known name nor a file of an avoider."""
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
    """Return the hash of the avoider's file.

    The hash is empty if the scenario has no avoider, or if its avoider has no file.
    """
    path = None if scenario.driven else avoider_file_of(scenario)
    return "" if path is None else hashlib.sha256(path.read_bytes()).hexdigest()


def command_line_reference(scenario: Scenario) -> str:
    """Return the reference to the system under test, with its path relative to the working directory."""
    return _from_here(scenario, scenario.under_test)


def _from_here(scenario: Scenario, reference: str) -> str:
    """Convert a path relative to the scenario's folder into a path relative to the working directory.

    The path is part of ``reference``.
    """
    folder = folder_of(scenario) or Path()
    return with_file(reference, lambda file: file if is_shipped(file) else os.path.relpath(folder / file))


def told_avoider(reference: str) -> str:
    """Return the reference to the system under test.

    The path of its file is written in the form that results use.
    """
    return str(with_file(reference, lambda file: str(display_path(Path(os.path.expanduser(file))))))


def option_of(reference: str) -> str:
    """Return the command-line option that accepts ``reference``: ``--controller`` or ``--avoider``."""
    return "--controller" if isinstance(reference, Driver) else "--avoider"


def one_of(avoider: str | None, controller: str | None) -> str | None:
    """Return ``avoider`` or ``controller``, whichever the user gave, or None if the user gave no value.

    Raise InadmissibleError if the user gave both.
    """
    if avoider is not None and controller is not None:
        expected = "one of --avoider and --controller: only the visual servo asks an avoider"
        raise InadmissibleError.of_option("--controller", expected, "both")
    return avoider if controller is None else Driver(controller)


def replay_command(
    scenario: Scenario,
    trace: Path,
    *more_traces: Path,
    verb: str = "replay",
    made_in: str = "",
    shown_path: Callable[[Path], Path] = display_path,
) -> str:
    """Return the command that repeats runs of one avoider or controller.

    If the system is a user's program, the command names the program explicitly.  Otherwise a trace from an
    untrusted source could decide which program is executed.

    Args:
        scenario: The scenario of the runs.
        trace: The trace.
        *more_traces: Further traces.
        verb: The command that repeats runs.
        made_in: The world of the traces. If the traces come from a user's simulator, the command also states
            this simulator.
        shown_path: A function that returns a file's path as the command should show it.  If the command is
            not stored, it may name files by their full paths.

    """
    parts = ["safety-harness", verb, *(str(shown_path(file)) for file in (trace, *more_traces))]
    if is_a_program(scenario.under_test):
        parts += [option_of(scenario.under_test), _named_here(command_line_reference(scenario))]
    for name, option in BESIDE.items():
        if is_a_program(reference := getattr(scenario, name)):
            parts += [option, _named_here(_from_here(scenario, reference))]
    return shlex.join([*parts, *world_option(made_in)])


def _named_here(reference: str) -> str:
    """Return a reference that is relative to the working directory, as a command on this machine shows it."""
    return told_avoider(os.path.abspath(reference) if file_and_name(reference)[0] else reference)


def with_program(
    scenario: Scenario,
    tested: str | None,
    file: Path | None = None,
    verb: str = "replay",
    beside: Mapping[str, str | None] | None = None,
) -> Scenario:
    """Return the scenario of a trace with the avoider or controller that the user gave.

    Repeating a trace from an untrusted source must not execute the program that the trace refers to.

    Args:
        scenario: The scenario of the trace.
        tested: The user's reference.  None means that the trace's own reference is used.
        file: The file of the trace, for the error.
        verb: The command that repeats the run, for the hint.
        beside: The user's references for the parts in ``BESIDE``, such as a safety filter. None means that
            the trace's own references are used.

    Raises:
        TraceError: A program produced the trace, and the user did not state that program.

    """
    unnamed: dict[str, str] = {}  # by option
    if tested is not None:
        scenario = with_avoider(scenario, tested)
    elif is_a_program(scenario.under_test):
        unnamed[option_of(scenario.under_test)] = scenario.under_test
    for name, option in BESIDE.items():
        own, again = getattr(scenario, name), (beside or {}).get(name)
        if again is not None:
            if not own:
                expected = f"a trace with a {name.replace('_', ' ')}"
                raise TraceError(place=Place(file=file, field=option), expected=expected, got="none")
            scenario = with_part(scenario, name, again)
        elif is_a_program(own):
            unnamed[option] = own
    for option, program in unnamed.items():
        got = f"a trace made with {program}"
        place = Place(file=file, field=option.removeprefix("--"))
        expected = f"the program named with {option}, since repeating the run executes it"
        hint = "" if file is None else replay_command(scenario, file, verb=verb)
        raise TraceError(place=place, expected=expected, got=got, hint=hint)
    return scenario


def scenario_of_avoider(reference: str) -> Scenario:
    """Return a scenario that contains only an avoider, for callers that have no scenario file."""
    return Scenario(
        name="avoider",
        title="a scenario with only an avoider",
        about="",
        duration_s=1.0,
        seed=0,
        start=OffsetStart(offset_in_base_m=(0.0, 0.0, 0.0)),
        hands=(),
        avoider=reference,
        claims=(),
    )


def shipped_avoider(name: str, settings: Settings = DEFAULTS) -> Avoider:
    """Return a shipped avoider by its name, as an object that can be queried.

    For example, the result can be wrapped in an ``AvoiderAround``.

    Args:
        name: The name, such as ``mc-dropout``; ``NAMES`` lists all names.
        settings: The settings for the avoider.

    Raises:
        InadmissibleError: The name is unknown.
        ModelError: The avoider was trained for a cell other than the cell in ``settings``.

    """
    refuse_other_type("shipped_avoider(name)", name, str, expected=f"one of: {', '.join(NAMES)}")
    if name not in NAMES:
        hint = near_miss(name, NAMES, most=3)
        raise InadmissibleError.of_option("avoider", f"one of: {', '.join(NAMES)}", repr(name), hint)
    return resolve_avoider(replace(scenario_of_avoider(name), settings=settings))


def is_a_program(reference: str) -> bool:
    """Return whether ``reference`` refers to a Python file or a program.

    Such a reference can only be resolved by executing user code.
    """
    return file_and_name(reference)[0].endswith(".py") or names_a_program(reference)


def is_executed(reference: str) -> bool:
    """Return whether a run executes the file to which ``reference`` leads.

    This is the case for a program, a Python file and an ONNX file.
    """
    return is_a_program(reference) or names_onnx(reference)


def executes(scenario: Scenario) -> bool:
    """Return whether a run of the scenario executes a user's file.

    The file may be the scenario's avoider or controller, its safety filter or its predictor.
    """
    return any(map(is_executed, scenario.parts_under_test))


def folder_of(scenario: Scenario) -> Path | None:
    """Return the folder to which the scenario's paths are relative.

    None means the working directory.
    """
    return scenario.file.parent if scenario.file is not None else None


def avoider_file_of(scenario: Scenario) -> Path | None:
    """Return the path of the avoider's file, or None for an avoider without a file.

    The file need not exist.
    """
    if scenario.avoider in SHIPPED:
        return shipped_model(scenario.avoider)
    file, _ = file_and_name(scenario.avoider)
    return resolved(located((folder_of(scenario) or Path()) / os.path.expanduser(file))) if file else None


def with_avoider(scenario: Scenario, reference: str, place: Place | None = None) -> Scenario:
    """Return the scenario with another avoider or controller.

    The result contains the file's path relative to the scenario's folder.  Therefore the trace of a run
    identifies the avoider, and ``replay`` finds the file.

    Args:
        scenario: The scenario.
        reference: The reference to an avoider, or a ``Driver`` for a controller.  A relative path starts from
            the working directory.
        place: The place that error messages state, such as a command-line option.  None means ``--avoider``
            or ``--controller``.

    Raises:
        InadmissibleError: The reference cannot be written into a scenario file, or the scenario's controller
            never queries an avoider.

    """
    if isinstance(reference, Driver):
        return _driven_by(scenario, reference, place or Place(field="--controller"))
    place = place or Place(field="--avoider")
    if scenario.driven:
        expected = f"no avoider, since the scenario's controller {scenario.controller} does not ask any"
        raise InadmissibleError(place=place, expected=expected, got=repr(reference))
    return replace(scenario, **_placed(scenario, "avoider", "an avoider", reference, place))


def _placed(scenario: Scenario, key: str, noun: str, reference: str, place: Place) -> dict[str, Any]:
    """Return the fields of the scenario that change.

    These fields are the value of ``key``, and the place that messages state for ``key``.
    """
    folder = resolved(folder_of(scenario) or Path())
    text = str(
        with_file(
            reference, lambda file: named_from(folder, resolved(located(os.path.expanduser(file), place)))
        )
    )
    if not is_sentence(text):
        raise InadmissibleError(place=place, expected=f"{noun}'s name or file, {SENTENCE}", got=repr(text))
    return {key: text, "places": ChainMap({key: place}, scenario.places)}  # type: ignore[arg-type]  # it is only read


def _driven_by(scenario: Scenario, reference: Driver, place: Place) -> Scenario:
    """Return the scenario with ``reference`` as its controller.

    If the new controller is the visual servo, the scenario keeps its avoider, or gets the default avoider.
    With any other controller, the scenario has no avoider.
    """
    changes = _placed(scenario, "controller", "a controller", reference, place)
    servo = changes["controller"] == VISUAL_SERVO
    return replace(scenario, avoider=scenario.avoider or DEFAULT_AVOIDER if servo else NO_AVOIDER, **changes)


def _from_model_file(path: Path, settings: Settings) -> Avoider:
    """Return the avoider in a model file.

    Raise ModelError if it was trained for another cell.
    """
    try:
        with path.open("rb") as file:
            digest = hashlib.sha256(file.read(LARGEST_BYTES + 1)).hexdigest()
    except OSError:
        digest = ""  # loading the model reports the cause
    avoider = _learned(path, digest)
    refuse_foreign_cell(avoider.model, settings, path)
    return avoider


@lru_cache(maxsize=4)  # the scenarios of a folder share one or two models
def _learned(path: Path, sha256: str) -> LearnedAvoider:
    """Return the avoider in the model file ``path``.

    ``sha256`` is only a key of the cache: if the file changes, it is loaded again.
    """
    from safety_harness.cell.avoidance.learned import LearnedAvoider
    from safety_harness.cell.avoidance.model_file import load_model

    return LearnedAvoider.from_model(load_model(path))


def _refuse_foreign_onnx(path: Path, settings: Settings) -> None:
    """Raise ModelError if ``path`` is an ONNX file whose network was trained for another cell.

    The function can only check ONNX files that this package exported.
    """
    network = exported_use(path)
    if network is not None:
        refuse_foreign_cell(network, settings, path)


def as_seen_from(folder: Path, scenario: Scenario) -> Scenario:
    """Return the scenario with its file paths relative to ``folder``.

    They are the paths of recordings and of programs or models.
    """
    old_folder = scenario.file.parent if scenario.file else Path()
    moved = scenario.with_files(lambda path: named_from(folder, old_folder / path))
    moved = replace(moved, file=folder / "scenario.yaml")
    for name in BESIDE:
        if is_a_program(reference := getattr(scenario, name)):
            moved = with_part(moved, name, _from_here(scenario, reference))
    has_file = bool(file_and_name(scenario.under_test)[0])
    return with_avoider(moved, command_line_reference(scenario)) if has_file else moved


def with_part(scenario: Scenario, field: str, reference: str) -> Scenario:
    """Return the scenario with ``reference`` as its safety filter or predictor, depending on ``field``.

    A relative path starts from the working directory. Raise InadmissibleError if the reference cannot be
    written into a scenario file.
    """
    noun, place = f"a {field.replace('_', ' ')}", Place(field=BESIDE[field])
    return replace(scenario, **_placed(scenario, field, noun, reference, place))


def with_system_of(like: Scenario, scenario: Scenario) -> Scenario:
    """Return ``scenario`` with the avoider or controller of ``like``.

    The paths of the result are relative to the folder of ``like``. If both scenarios already have the same
    avoider or controller, ``scenario`` is returned unchanged.
    """
    tested = [(each.driven, command_line_reference(each)) for each in (like, scenario)]
    if tested[0] == tested[1]:
        return scenario
    places = {**scenario.places, **{key: like.place(key) for key in ("avoider", "controller")}}
    moved = as_seen_from(folder_of(like) or Path(), scenario)
    return replace(moved, file=like.file, avoider=like.avoider, controller=like.controller, places=places)
