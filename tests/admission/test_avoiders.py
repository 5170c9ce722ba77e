"""Which avoider a reference means; what a user's own file may be, and how it is refused."""

from __future__ import annotations

import hashlib
import os
import signal
from dataclasses import replace
from pathlib import Path
from threading import Timer

import numpy as np
import pytest
from examples import VISIT, Displaced, run, scenario

from safety_harness import admit, judge, parse_scenario, write_scenario
from safety_harness.admission.avoiders import NAMES, resolve_avoider, shipped_avoider, with_avoider
from safety_harness.base.exceptions import InadmissibleError, Place
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.shipped import SHIPPED, shipped_model
from safety_harness.scenario.model import Claim, Scenario, Verdict

PROPOSE = """
    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.07])
"""
HEAD = "from safety_harness import Proposal\n"
GOOD = HEAD + "class Mine:\n    name = 'mine'" + PROPOSE


def write(folder: Path, text: str, name: str = "mine.py") -> Path:
    file = folder / name
    file.write_text(text)
    return file


def named(reference: str, folder: Path) -> Scenario:
    """A scenario in ``folder`` that names its avoider in line 7."""
    file = folder / "f.yaml"
    return replace(
        scenario(avoider=reference),
        file=file,
        places={"avoider": Place(file=file, line=7, field="avoider")},
    )


def refused(reference: str, folder: Path) -> InadmissibleError:
    with pytest.raises(InadmissibleError) as caught:
        admit(named(reference, folder))
    assert caught.value.place == Place(file=folder / "f.yaml", line=7, field="avoider")
    assert "Traceback" not in str(caught.value)
    assert "\n" not in str(caught.value)
    return caught.value


def up(avoider: Avoider) -> float:
    """How far above the TCP it proposes to go."""
    here = np.array([0.7, 0.0, 0.35])
    proposal = avoider.propose(hand_position_in_base_m=here + 0.2, tcp_position_in_base_m=here, seed=1)
    return float(proposal.position_in_base_m[2] - here[2])


@pytest.mark.parametrize("name", sorted(set(NAMES) - set(SHIPPED)))
def test_a_name_of_ours_is_the_avoider_of_that_name(name: str) -> None:
    assert resolve_avoider(scenario(avoider=name)).name == name


@pytest.mark.parametrize("name", SHIPPED)
def test_the_name_of_a_shipped_network_is_that_network_calibrated(name: str) -> None:
    avoider = resolve_avoider(scenario(avoider=name))
    assert isinstance(avoider, LearnedAvoider)
    assert avoider.spread_threshold_m is not None
    assert avoider.model.card["recipe"]["name"] == name


def test_a_run_says_which_file_its_avoider_came_from(tmp_path: Path) -> None:
    write(tmp_path, GOOD)
    digest = hashlib.sha256((tmp_path / "mine.py").read_bytes()).hexdigest()
    assert admit(named("mine.py:Mine", tmp_path)).avoider_sha256 == digest
    shipped = hashlib.sha256(shipped_model("mc-dropout").read_bytes()).hexdigest()
    assert admit(scenario(avoider="mc-dropout")).avoider_sha256 == shipped
    assert admit(scenario(avoider="opposite pose")).avoider_sha256 == ""


def test_a_class_and_an_object_of_a_file_are_avoiders(tmp_path: Path) -> None:
    write(tmp_path, GOOD + "thing = Mine()\nthing.name = 'the thing'\n")
    assert admit(named("mine.py:Mine", tmp_path)).avoider.name == "mine"
    assert admit(named("mine.py:thing", tmp_path)).avoider.name == "the thing"
    assert up(admit(named("mine.py:Mine", tmp_path)).avoider) == pytest.approx(0.07)


def test_a_scenarios_file_is_sought_beside_it_and_a_command_lines_in_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
        write(folder, GOOD.replace("'mine'", repr(folder.name)))
    monkeypatch.chdir(here)
    stands_there = named("mine.py:Mine", there)
    assert admit(stands_there).avoider.name == "there"
    assert admit(named("../here/mine.py:Mine", there)).avoider.name == "here"
    assert resolve_avoider(scenario(avoider="mine.py:Mine")).name == "here"
    assert resolve_avoider(scenario(avoider=f"{there}/mine.py:Mine")).name == "there"


def test_two_files_of_the_same_name_do_not_hide_each_other_nor_the_library(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write(tmp_path / name, GOOD.replace("'mine'", repr(name)), "random.py")
    first = admit(named("a/random.py:Mine", tmp_path)).avoider
    second = admit(named("b/random.py:Mine", tmp_path)).avoider
    assert (first.name, second.name) == ("a", "b")
    import random

    assert random.random() < 1.0


def test_a_dataclass_with_postponed_annotations_can_be_an_avoider(tmp_path: Path) -> None:
    fields = "@dataclass\nclass Mine:\n    step_m: float = 0.03\n    name: str = 'mine'"
    write(tmp_path, "from __future__ import annotations\nfrom dataclasses import dataclass\n" + HEAD)
    with (tmp_path / "mine.py").open("a") as file:
        file.write(fields + PROPOSE)
    assert admit(named("mine.py:Mine", tmp_path)).avoider.name == "mine"


def test_an_edited_file_is_read_again(tmp_path: Path) -> None:
    write(tmp_path, GOOD)
    assert up(admit(named("mine.py:Mine", tmp_path)).avoider) == pytest.approx(0.07)
    write(tmp_path, GOOD.replace("0.07", "0.05"))  # within the same second, and of the same length
    assert up(admit(named("mine.py:Mine", tmp_path)).avoider) == pytest.approx(0.05)
    assert [file.name for file in tmp_path.iterdir()] == ["mine.py"]  # and nothing is left beside it


NOT_IMPORTED = {
    "raises when imported": ("x = 1\n\ny = x / 0\n", "ZeroDivisionError: division by zero (mine.py:3)"),
    "raises in what it calls": (
        "import json\n\n\njson.loads('[')\n",
        "JSONDecodeError: Expecting value: line 1 column 2 (char 1) (mine.py:4)",
    ),
    "is no Python": ("x = 1\ndef f(:\n", "SyntaxError: invalid syntax (mine.py:2)"),
    "exits": ("raise SystemExit(3)\n", "SystemExit: 3 (mine.py:1)"),
    "raises what looks like Ctrl-C": ("raise KeyboardInterrupt\n", "KeyboardInterrupt (mine.py:1)"),
    "ends the process": ("import os\nos._exit(3)\n", "its process ended with exit status 3"),
    "kills it": (
        "import os, signal\nos.kill(os.getpid(), signal.SIGTERM)\n",
        "its process was ended by SIGTERM",
    ),
    "imports what is not there": (
        "import no_such_module_at_all\n",
        "ModuleNotFoundError: No module named 'no_such_module_at_all' (mine.py:1)",
    ),
    "holds a null byte": ("x = 1\x00\n", "SyntaxError: source code string cannot contain null bytes"),
}
NO_AVOIDERS = {  # all of them in one file, so that one process looks at them
    "raises when made": (
        "class Mine:\n    def __init__(self):\n        raise KeyError('weights')\n",
        "KeyError: 'weights' (mine.py:{last_line})",
    ),
    "exits when made": (
        "class Mine:\n    def __init__(self):\n        raise SystemExit\n",
        "SystemExit (mine.py:{last_line})",
    ),
    "needs arguments": (
        "class Mine:\n    def __init__(self, radius_m):\n        pass\n",
        "TypeError: {name}.__init__() missing 1 required positional argument: 'radius_m'",
    ),
    "has nothing of that name": ("class Other:\n    pass\n", "no such name"),
    "has no propose": ("class Mine:\n    name = 'mine'\n", "no such method in a {name}"),
    "has a propose that is no method": (
        "class Mine:\n    name = 'mine'\n    propose = 3\n",
        "no such method in a {name}",
    ),
    "has another signature": (
        "class Mine:\n    name = 'mine'\n    def propose(self, hand, tcp):\n        pass\n",
        "propose(hand, tcp)",
    ),
    "asks for more": (
        "class Mine:\n    name = 'mine'\n"
        "    def propose(self, hand_position_in_base_m, tcp_position_in_base_m, seed, *, force): pass\n",
        "propose(hand_position_in_base_m, tcp_position_in_base_m, seed, *, force)",
    ),
    "has no name": (HEAD + "class Mine:" + PROPOSE, "None"),
    "has a name of two lines": (GOOD.replace("'mine'", "'two\\nlines'"), "'two\\nlines'"),
    "has a threshold that is none": (
        GOOD + "    spread_threshold_m = 'little'\n",
        "spread_threshold_m must be a length in metres, or None; got 'little'",
    ),
    "has a threshold below zero": (
        GOOD + "    spread_threshold_m = -0.01\n",
        "spread_threshold_m must be a length in metres, or None; got -0.01",
    ),
}


@pytest.fixture(scope="module")
def no_avoiders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a file that has them all: the k-th is ``Mine{k}``."""
    folder = tmp_path_factory.mktemp("none")
    write(
        folder, "".join(text.replace("Mine", f"Mine{k}") for k, (text, _) in enumerate(NO_AVOIDERS.values()))
    )
    return folder


@pytest.mark.parametrize(("text", "got"), NOT_IMPORTED.values(), ids=NOT_IMPORTED.keys())
def test_a_file_that_cannot_be_imported_is_refused_with_what_is_wrong(
    text: str, got: str, tmp_path: Path
) -> None:
    write(tmp_path, text)
    error = refused("mine.py:Mine", tmp_path)
    assert error.got == got
    assert "Mine" in error.expected or "mine.py" in error.expected


@pytest.mark.parametrize("what", NO_AVOIDERS)
def test_what_is_no_avoider_in_a_file_is_refused_with_what_is_wrong(what: str, no_avoiders: Path) -> None:
    k = list(NO_AVOIDERS).index(what)
    name = f"Mine{k}"
    error = refused(f"mine.py:{name}", no_avoiders)
    last_line = sum(text.count("\n") for text, _ in list(NO_AVOIDERS.values())[: k + 1])
    assert error.got == NO_AVOIDERS[what][1].format(name=name, last_line=last_line)
    assert name in error.expected or "mine.py" in error.expected


def test_ctrl_c_while_a_file_is_imported_is_not_swallowed(tmp_path: Path) -> None:
    write(tmp_path, "import time\ntime.sleep(60)\n")
    Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        admit(named("mine.py:Mine", tmp_path))


@pytest.mark.parametrize(
    ("reference", "expected", "got", "hint"),
    [
        ("oposite pose", "opposite pose", "'oposite pose'", 'did you mean "opposite pose"?'),
        ("mine.py", "FILE.py:NAME", "'mine.py'", "mine.py:"),
        ("gone.py:Mine", "a file that can be read", "gone.py", ""),
        ("gone.safetensors", "a file that can be read", "gone.safetensors", ""),
        (".:Mine", "FILE.py:NAME", "'.:Mine'", ""),
        ("mine.txt:Mine", "FILE.py:NAME", "'mine.txt:Mine'", ""),
        ("https://example.org/mine.py:Mine", "a file that can be read", "no such file", ""),
    ],
)
def test_a_reference_to_nothing_is_refused(
    reference: str, expected: str, got: str, hint: str, tmp_path: Path
) -> None:
    write(tmp_path, GOOD)
    error = refused(reference, tmp_path)
    assert expected in error.expected
    assert got in error.got
    assert hint in error.hint


def test_a_mistake_on_the_command_line_is_placed_there(tmp_path: Path) -> None:
    with pytest.raises(InadmissibleError) as caught:
        admit(with_avoider(named("opposite pose", tmp_path), "gone.py:Mine"))
    assert str(caught.value.place) == "--avoider"
    with pytest.raises(InadmissibleError, match="200 printable") as caught:
        with_avoider(named("opposite pose", tmp_path), "x" * 250 + ".py:Mine")
    assert str(caught.value.place) == "--avoider"


@pytest.mark.parametrize("reference", ["mine.py:Mine", "../here/mine.py:Mine", "{here}/mine.py:Mine"])
def test_a_command_lines_avoider_is_found_again_by_a_replay_from_elsewhere(
    reference: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
        write(folder, GOOD.replace("'mine'", repr(folder.name)))
    monkeypatch.chdir(here)
    changed = with_avoider(named("opposite pose", there), reference.format(here=here))
    assert changed.avoider == "../here/mine.py:Mine"
    assert admit(changed).avoider.name == "here"
    monkeypatch.chdir(there)
    again = parse_scenario(write_scenario(changed), there / "f.yaml", claims_required=False)
    assert admit(again).avoider.name == "here"


def test_a_name_of_ours_on_the_command_line_stays_a_name(tmp_path: Path) -> None:
    assert with_avoider(named("mine.py:Mine", tmp_path), "nearest candidate").avoider == "nearest candidate"
    model = with_avoider(named("opposite pose", tmp_path), str(tmp_path / "net.safetensors"))
    assert model.avoider == "net.safetensors"


def test_a_given_avoider_is_taken_without_looking_at_the_named_one(tmp_path: Path) -> None:
    class Falsy(Displaced):
        def __len__(self) -> int:
            return 0

    given = Falsy((0.0, 0.0, 0.1))
    assert admit(named("gone.py:Mine", tmp_path), avoider=given).avoider is given


def test_judging_a_trace_executes_no_avoider(tmp_path: Path) -> None:
    write(tmp_path, "import pathlib\n(pathlib.Path(__file__).parent / 'ran').touch()\n" + GOOD)
    claims = (Claim(sentence="joint speeds within limits", expected=Verdict.HOLDS),)
    trace = run(replace(named("mine.py:Mine", tmp_path), claims=claims, duration_s=0.1))
    assert (tmp_path / "ran").exists()
    (tmp_path / "ran").unlink()
    assert judge(trace)[0].verdict is Verdict.HOLDS
    assert not (tmp_path / "ran").exists()


def test_a_scenario_with_a_users_avoider_is_written_and_read_again(tmp_path: Path) -> None:
    before = replace(named("my folder/mine.py:Mine", tmp_path), claims=())
    after = parse_scenario(write_scenario(before), claims_required=False)
    assert after.avoider == "my folder/mine.py:Mine"


def test_a_fault_of_a_users_file_is_told_with_its_line(tmp_path: Path) -> None:
    body = "    name = 'mine'\n    def propose(self, **question):\n        return self.step()\n"
    write(tmp_path, "class Mine:\n" + body + "    def step(self):\n        return 1 / 0\n")
    trace = run(replace(named("mine.py:Mine", tmp_path), hands=(VISIT,), duration_s=1.0))
    assert trace.complete
    assert set(trace.decisions["fault"]) == {"ZeroDivisionError: division by zero (mine.py:6)"}


def test_each_of_ours_is_had_by_its_name_and_no_other() -> None:
    for name in NAMES:
        avoider = shipped_avoider(name)
        tcp = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
        proposal = avoider.propose(
            hand_position_in_base_m=tcp + [0.2, 0.1, 0.0], tcp_position_in_base_m=tcp, seed=1
        )
        assert np.isfinite(proposal.position_in_base_m).all()
    with pytest.raises(InadmissibleError, match='did you mean "mc-dropout"'):
        shipped_avoider("mc-dropuot")
    with pytest.raises(InadmissibleError):
        shipped_avoider("mine.py:Mine")


def test_a_file_that_imports_its_neighbour_is_told_how(tmp_path: Path) -> None:
    (tmp_path / "helper.py").write_text("UP = 0.1\n")
    (tmp_path / "mine.py").write_text("from helper import UP\n")
    (tmp_path / "other.py").write_text("from no_such_module import UP\n")
    with pytest.raises(InadmissibleError) as caught:
        resolve_avoider(scenario(avoider=f"{tmp_path}/mine.py:Mine"))
    assert caught.value.hint.startswith("PYTHONPATH=")
    with pytest.raises(InadmissibleError) as caught:
        resolve_avoider(scenario(avoider=f"{tmp_path}/other.py:Mine"))
    assert caught.value.hint == ""
