"""A toy package adds a part of each kind without an edit of the core; one that is broken stops nothing."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from toy_package import SHORT, WITHOUT_WINGS, called, install

# A fresh process takes a second to load what each of these commands needs.  This one has it loaded, and each
# command is done by a process that forks from it, so that none finds anything of another one.
FORKS = """
import gc
import json
import os
import sys
import traceback
from safety_harness import WORLDS, admit, judge, load_trace, read_scenario, run_trial
from safety_harness.__main__ import main
from safety_harness.cli.explain import explain_claims
import safety_harness.cli.main
gc.collect()
gc.freeze()  # what is loaded is no child's to look through
for line in sys.stdin:
    folder, code, words = json.loads(line)
    if (child := os.fork()) == 0:
        os.chdir(folder)
        for stream, name in ((1, "stdout"), (2, "stderr")):
            os.dup2(os.open(name, os.O_CREAT | os.O_WRONLY | os.O_TRUNC), stream)
        sys.argv, status = ["safety-harness", *words], 0
        try:
            exec(code, {"__name__": "__main__"}) if code else main()
        except SystemExit as ended:
            status = ended.code or 0
        except BaseException:
            traceback.print_exc()
            status = 1
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


VIOLATED = SHORT.partition("claims:")[0] + "claims:\n  hand distance never below 2 m: holds\n"


class Forking:
    """What does commands and code in processes that have everything loaded."""

    def __init__(self, process: subprocess.Popen[str], folder: Path) -> None:
        self.process, self.folder = process, folder

    def called(
        self, *words: str, code: str = "", folder: Path | None = None
    ) -> subprocess.CompletedProcess[str]:
        place = folder or self.folder
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps([str(place), code, words]) + "\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline()
        assert answer, "the process ended"
        stdout, stderr = ((place / name).read_text() for name in ("stdout", "stderr"))
        return subprocess.CompletedProcess(list(words), int(answer), stdout, stderr)


@contextmanager
def forking(folder: Path, *paths: str, first: str = "") -> Iterator[Forking]:
    path = os.pathsep.join([*paths, *filter(None, [os.environ.get("PYTHONPATH")])])
    process = subprocess.Popen(
        [sys.executable, "-c", first + FORKS],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": path},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with process:
        yield Forking(process, folder)
        assert process.stdin is not None
        process.stdin.close()


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that is the installation of a package with parts of each kind, some unusable."""
    return install(tmp_path_factory.mktemp("toy"))


@pytest.fixture(scope="module")
def loaded(toy: Path) -> Iterator[Forking]:
    """Where that package is installed."""
    with forking(toy, str(toy)) as made:
        yield made


@pytest.fixture(scope="module")
def without_wings(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Forking]:
    folder = tmp_path_factory.mktemp("core")
    with forking(folder, first=WITHOUT_WINGS.partition("from safety_harness")[0]) as made:
        yield made


def test_the_toys_command_is_there_and_nothing_else_is_loaded(toy: Path) -> None:
    done = called(toy, "toy")
    assert (done.returncode, done.stdout, done.stderr) == (0, "the toy is there\n", "")


def test_the_help_has_the_toys_command_and_names_those_that_cannot_be_used(loaded: Forking) -> None:
    done = loaded.called("--help")
    assert done.returncode == 0
    assert re.search(r"─ Toy 1.0 ─.*\n. toy  +Say that the toy is there", done.stdout)
    warnings = [line for line in done.stderr.splitlines() if line.startswith("warning: skipped")]
    found = {line.partition(" of ")[0].rpartition(" ")[2]: line for line in warnings}
    assert {*found} == {"gone", "greedy", "run", "wrong"}
    assert "no_such_name" in found["gone"]
    assert "it has no command greedy" in found["greedy"]
    assert "the command run is there already" in found["run"]
    assert "expected Typer, got InputFile" in found["wrong"]


@pytest.mark.parametrize("command", ["gone", "greedy", "wrong"])
def test_a_command_that_cannot_be_loaded_is_no_command(loaded: Forking, command: str) -> None:
    done = loaded.called(command)
    assert done.returncode == 2
    assert f"skipped safety_harness.commands {command} of toy 1.0" in done.stderr
    assert "No such command" in done.stderr


def test_no_part_replaces_a_command(loaded: Forking) -> None:
    done = loaded.called("run", "--help")
    assert "Run scenario files" in done.stdout
    assert "taken over" not in done.stdout


def test_the_version_loads_no_wing(toy: Path) -> None:
    code = """
import sys
from safety_harness.__main__ import main
try:
    main()
finally:
    print([one for one in sys.modules if one.startswith("safety_harness.extensions.") or one == "toy"])
"""
    assert called(toy, "--version", code=code).stdout.endswith("\n[]\n")


def test_the_toys_files_are_checked_explained_and_called_by_their_name(toy: Path, loaded: Forking) -> None:
    (toy / "mine.yaml").write_text("toy: a cart\n")
    (toy / "bad.yaml").write_text("toy: broken\n")
    done = loaded.called("validate", "mine.yaml")
    assert (done.returncode, done.stdout) == (0, "ok mine.yaml: a toy, with two wheels\n")
    bad = loaded.called("validate", "bad.yaml")
    assert bad.returncode == 2
    assert "expected a toy that is whole" in bad.stderr
    assert loaded.called("explain", "mine.yaml").stdout == "mine.yaml has two wheels\n"
    run = loaded.called("run", "mine.yaml")
    assert run.returncode == 2
    assert "a toy" in run.stderr
    assert "safety-harness toy mine.yaml" in run.stderr


def test_no_package_takes_the_place_of_files_that_the_core_reads(toy: Path, loaded: Forking) -> None:
    (toy / "own.yaml").write_text(
        SHORT.partition("claims:")[0] + "claims:\n  trace finite and monotone: holds\n"
    )
    done = loaded.called("validate", "own.yaml")
    assert "with two wheels" not in done.stdout
    assert done.stdout.startswith("ok own.yaml: 1 hand")


def test_the_toys_claim_signal_world_and_note_are_used_and_evidence_names_them(
    toy: Path, loaded: Forking
) -> None:
    code = """
from pathlib import Path
from safety_harness import admit, judge, read_scenario, run_trial, WORLDS
from safety_harness.cli.explain import explain_claims
world = next(one for one in WORLDS if one.name == "toy")
text = Path("short.yaml").read_text()
trace = run_trial(admit(read_scenario(Path("short.yaml"))), world=world)
print(*(f"{one.sentence}: {one.verdict.value}" for one in judge(trace)), sep="\\n")
print(*(name for name, _ in trace.provenance.libraries if "entry point" in name), sep="\\n")
print([one.name for one in WORLDS])
from safety_harness.cell.simulation.worlds import worlds_by_label
print("the reference is", worlds_by_label()["PyBullet"].name)
from safety_harness.cell.simulation.worlds import world_named
print("its program is", world_named("toy:two wheels", "--world").name)
print("ours is", world_named("exec:true", "--world").load.func.__module__)
explain_claims(["toy", "distance"])
"""
    (toy / "short.yaml").write_text(SHORT)
    done = loaded.called(code=code)
    assert done.returncode == 0, done.stderr
    assert "always toy height > -1 m: holds" in done.stdout
    assert "toy distance > 30 mm: " in done.stdout
    assert "entry point safety_harness.worlds toy of toy 1.0" in done.stdout
    assert "['pybullet', 'kinematic', 'mujoco', 'toy']" in done.stdout
    assert "a note of the toy" in done.stdout
    assert "the reference is pybullet" in done.stdout
    assert "its program is toy:two wheels" in done.stdout
    assert "ours is safety_harness.extensions.worlds.program" in done.stdout
    assert "skipped safety_harness.worlds zz: another part has its name" in done.stderr
    assert "another part has its name" in done.stderr


KEYED = (
    SHORT.partition("claims:")[0]
    + """extensions: {toy: 30 mm}
claims:
  toy distance > 30 mm: holds
"""
)


def test_the_toys_key_is_read_stored_written_and_explained(toy: Path, loaded: Forking) -> None:
    code = """
from dataclasses import replace
from pathlib import Path
from safety_harness import WORLDS, admit, load_trace, parse_scenario, read_scenario, run_trial, save_trace
from safety_harness import write_scenario
scenario = read_scenario("keyed.yaml")
print(scenario.extensions)
trace = run_trial(admit(scenario), world=next(one for one in WORLDS if one.batch))
save_trace(trace, Path("keyed.trace"))
print(load_trace(Path("keyed.trace")).scenario.extensions)
print(parse_scenario(write_scenario(scenario)).extensions == scenario.extensions)
without = replace(scenario, extensions=())
print(without == scenario, "extensions" in write_scenario(without))
"""
    (toy / "keyed.yaml").write_text(KEYED)
    done = loaded.called(code=code)
    pairs = "(('toy', 0.03),)"
    assert done.stdout.splitlines() == [pairs, pairs, "True", "False False"], done.stderr


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{tyo: 30 mm}", "a key that an installed package adds: spoiled, toy"),
        ("{toy: 30 s}", "extensions.toy"),
        ("{toy: 2 m}", "extensions.toy"),
        ("{spoiled: 1}", "a package that adds the entry point spoiled to safety_harness.scenario_keys"),
    ],
)
def test_a_key_that_no_package_reads_is_refused(toy: Path, loaded: Forking, text: str, message: str) -> None:
    (toy / "other.yaml").write_text(KEYED.replace("{toy: 30 mm}", text))
    done = loaded.called("validate", "other.yaml")
    assert done.returncode == 2
    assert message in " ".join(done.stderr.split())


def test_a_key_of_a_package_that_is_not_installed_is_refused(tmp_path: Path, without_wings: Forking) -> None:
    (tmp_path / "keyed.yaml").write_text(KEYED)
    done = without_wings.called("validate", "keyed.yaml", folder=tmp_path)
    assert done.returncode == 2
    assert "extensions.toy" in done.stderr
    assert "a key that an installed package adds: there is none" in done.stderr


def test_a_key_is_explained_even_beside_one_that_cannot_be_loaded(loaded: Forking) -> None:
    done = loaded.called("explain", "toy")
    assert "how wide the wheels are" in done.stdout
    assert "skipped safety_harness.scenario_keys spoiled of toy 1.0" in done.stderr


def test_a_space_may_vary_the_toys_key(toy: Path, loaded: Forking) -> None:
    space = KEYED.replace("scenario: short", "scenario space: wide").replace("30 mm}", "from 10 mm to 20 mm}")
    (toy / "space.yaml").write_text(space)
    done = loaded.called("sample", "space.yaml", "--count", "2", "--out", "drawn")
    assert done.returncode == 0, done.stderr
    texts = [file.read_text() for file in sorted((toy / "drawn").glob("*.yaml"))]
    widths = [float(width) for text in texts for width in re.findall(r"toy: (\S+) m\b", text)]
    assert len({*widths}) == 2
    assert all(0.01 <= width <= 0.02 for width in widths)


DRIVEN = (
    SHORT.replace("avoider: opposite pose", "controller: toy:left").partition("claims:")[0]
    + """
claims:
  trace finite and monotone: holds
"""
)


def test_the_toys_controller_drives_and_its_hash_is_in_the_trace(toy: Path, loaded: Forking) -> None:
    (toy / "driven.yaml").write_text(DRIVEN)
    done = loaded.called("run", "driven.yaml", "--world", "kinematic", "--out", "driven")
    assert done.returncode == 0, done.stderr
    assert "1 of 1 verdicts as expected" in done.stdout
    code = """
from pathlib import Path
from safety_harness import load_trace
tested = load_trace(Path("driven/traces/driven.trace")).system.tested
print(tested.name, tested.sha256)
"""
    assert loaded.called(code=code).stdout.split() == ["toy", "0" * 64]
    named = loaded.called("replay", "driven/traces/driven.trace", "--controller", "toy:left")
    assert (named.returncode, "identical" in named.stdout) == (0, True), named.stderr


def test_a_controller_that_cannot_be_opened_refuses_the_scenario(toy: Path, loaded: Forking) -> None:
    (toy / "locked.yaml").write_text(DRIVEN.replace("toy:left", "toy:locked"))
    done = loaded.called("run", "locked.yaml", "--world", "kinematic", "--out", "locked")
    assert done.returncode == 2
    assert "RuntimeError: the toy is locked" in " ".join(done.stderr.split())


def test_no_package_takes_the_place_of_a_way_to_a_controller_or_of_a_file(toy: Path, loaded: Forking) -> None:
    (toy / "mine.py").write_text("class Mine:\n    pass\n")
    for reference, message in (("exec:no-such-program", "no such program"), ("mine.py:Mine", "a method")):
        (toy / "own.yaml").write_text(DRIVEN.replace("toy:left", f'"{reference}"'))
        done = loaded.called("validate", "own.yaml")
        assert done.returncode == 2
        assert message in " ".join(done.stderr.split())
    assert "skipped safety_harness.controllers exec of toy 1.0: its name is taken" in done.stderr


def test_the_toys_section_is_on_the_page_of_a_run_and_one_that_fails_is_left_out(
    toy: Path, loaded: Forking
) -> None:
    (toy / "shown.yaml").write_text(SHORT)
    done = loaded.called("run", "shown.yaml", "--world", "kinematic", "--out", "shown")
    page = (toy / "shown" / "report.html").read_text()
    assert '<h3 id="run-1-added-0">Toy &lt;wheels&gt;</h3>' in page
    assert "least &amp; last" in page
    assert "run-1-added-1" not in page
    assert "skipped safety_harness.page_sections failing: RuntimeError: no wheels" in done.stderr


def test_pages_and_explanations_of_a_package_take_the_place_of_wings_that_are_absent(
    toy: Path, tmp_path: Path, without_wings: Forking
) -> None:
    space = VIOLATED.replace("scenario:", "scenario space:").replace("seed: 1\n", "")
    (tmp_path / "space.yaml").write_text(space.replace("speed: 1 m/s", "speed: from 0.9 m/s to 1.1 m/s"))
    for name in ("hand", "other"):
        (tmp_path / f"{name}.yaml").write_text(VIOLATED)
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "report.html").write_text("the page of an earlier run")
    alone = without_wings.called("run", "hand.yaml", "--world", "kinematic", "--out", "a", folder=tmp_path)
    assert "report: a/report.json" in alone.stderr
    assert not (tmp_path / "a" / "report.html").exists()
    with forking(tmp_path, str(toy), first=WITHOUT_WINGS.partition("from safety_harness")[0]) as both:
        both.called("run", "hand.yaml", "other.yaml", "--world", "kinematic", "--out", "b")
        searched = both.called("fuzz", "space.yaml", "--budget", "2", "--out", "found")
    assert (tmp_path / "b" / "report.html").read_text() == "a page of 2 runs"
    assert "whose fault: the wheels" in searched.stdout, searched.stderr
    findings = json.loads((tmp_path / "found" / "findings.json").read_text())
    assert [*findings["attribution_of_counterexamples"].values()] == [{"answer": "wheels"}]


@pytest.mark.parametrize(
    "command",
    [
        ("validate", "short.yaml"),
        ("run", "short.yaml", "--world", "kinematic", "--out", "out"),
        ("claims", "hand", "distance"),
        ("explain", "critical", "distance"),
        ("sample", "shipped:unseen-hand", "--count", "1", "--out", "drawn"),
    ],
    ids=lambda command: command[0],
)
def test_the_core_works_where_no_wing_is_installed(
    command: tuple[str, ...], tmp_path: Path, without_wings: Forking
) -> None:
    (tmp_path / "short.yaml").write_text(
        SHORT.partition("claims:")[0] + "claims:\n  trace finite and monotone: holds\n"
    )
    done = without_wings.called(*command, folder=tmp_path)
    assert (done.returncode, "warning: skipped" in done.stderr, "Traceback" in done.stderr) == (
        0,
        False,
        False,
    ), done.stderr
