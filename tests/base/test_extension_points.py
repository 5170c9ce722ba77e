"""A toy package adds a part of each kind without an edit of the core; one that is broken stops nothing."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from toy_package import SHORT, WITHOUT_WINGS, called, install


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that is the installation of a package with parts of each kind, some unusable."""
    return install(tmp_path_factory.mktemp("toy"))


def test_the_toys_command_is_there_and_nothing_else_is_loaded(toy: Path) -> None:
    done = called(toy, "toy")
    assert (done.returncode, done.stdout, done.stderr) == (0, "the toy is there\n", "")


def test_the_help_has_the_toys_command_and_names_those_that_cannot_be_used(toy: Path) -> None:
    done = called(toy, "--help")
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
def test_a_command_that_cannot_be_loaded_is_no_command(toy: Path, command: str) -> None:
    done = called(toy, command)
    assert done.returncode == 2
    assert f"skipped safety_harness.commands {command} of toy 1.0" in done.stderr
    assert "No such command" in done.stderr


def test_no_part_replaces_a_command(toy: Path) -> None:
    done = called(toy, "run", "--help")
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


def test_the_toys_files_are_checked_explained_and_called_by_their_name(toy: Path) -> None:
    (toy / "mine.yaml").write_text("toy: a cart\n")
    (toy / "bad.yaml").write_text("toy: broken\n")
    done = called(toy, "validate", "mine.yaml")
    assert (done.returncode, done.stdout) == (0, "ok mine.yaml: a toy, with two wheels\n")
    bad = called(toy, "validate", "bad.yaml")
    assert bad.returncode == 2
    assert "expected a toy that is whole" in bad.stderr
    assert called(toy, "explain", "mine.yaml").stdout == "mine.yaml has two wheels\n"
    run = called(toy, "run", "mine.yaml")
    assert run.returncode == 2
    assert "a toy" in run.stderr
    assert "safety-harness toy mine.yaml" in run.stderr


def test_no_package_takes_the_place_of_files_that_the_core_reads(toy: Path) -> None:
    (toy / "own.yaml").write_text(
        SHORT.partition("claims:")[0] + "claims:\n  trace finite and monotone: holds\n"
    )
    done = called(toy, "validate", "own.yaml")
    assert "with two wheels" not in done.stdout
    assert done.stdout.startswith("ok own.yaml: 1 hand")


def test_the_toys_claim_signal_world_and_note_are_used_and_evidence_names_them(toy: Path) -> None:
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
    done = called(toy, code=code)
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


def test_the_toys_key_is_read_stored_written_and_explained(toy: Path) -> None:
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
    done = called(toy, code=code)
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
def test_a_key_that_no_package_reads_is_refused(toy: Path, text: str, message: str) -> None:
    (toy / "other.yaml").write_text(KEYED.replace("{toy: 30 mm}", text))
    done = called(toy, "validate", "other.yaml")
    assert done.returncode == 2
    assert message in " ".join(done.stderr.split())


def test_a_key_of_a_package_that_is_not_installed_is_refused(tmp_path: Path) -> None:
    (tmp_path / "keyed.yaml").write_text(KEYED)
    done = called(tmp_path, "validate", "keyed.yaml")
    assert done.returncode == 2
    assert "extensions.toy" in done.stderr
    assert "a key that an installed package adds: there is none" in done.stderr


def test_a_key_is_explained_even_beside_one_that_cannot_be_loaded(toy: Path) -> None:
    done = called(toy, "explain", "toy")
    assert "how wide the wheels are" in done.stdout
    assert "skipped safety_harness.scenario_keys spoiled of toy 1.0" in done.stderr


def test_a_space_may_vary_the_toys_key(toy: Path) -> None:
    space = KEYED.replace("scenario: short", "scenario space: wide").replace("30 mm}", "from 10 mm to 20 mm}")
    (toy / "space.yaml").write_text(space)
    done = called(toy, "sample", "space.yaml", "--count", "2", "--out", "drawn")
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


def test_the_toys_controller_drives_and_its_hash_is_in_the_trace(toy: Path) -> None:
    (toy / "driven.yaml").write_text(DRIVEN)
    done = called(toy, "run", "driven.yaml", "--world", "kinematic", "--out", "driven")
    assert done.returncode == 0, done.stderr
    assert "1 of 1 verdicts as expected" in done.stdout
    code = """
from pathlib import Path
from safety_harness import load_trace
tested = load_trace(Path("driven/traces/driven.trace")).system.tested
print(tested.name, tested.sha256)
"""
    assert called(toy, code=code).stdout.split() == ["toy", "0" * 64]
    named = called(toy, "replay", "driven/traces/driven.trace", "--controller", "toy:left")
    assert (named.returncode, "identical" in named.stdout) == (0, True), named.stderr


def test_a_controller_that_cannot_be_opened_refuses_the_scenario(toy: Path) -> None:
    (toy / "locked.yaml").write_text(DRIVEN.replace("toy:left", "toy:locked"))
    done = called(toy, "run", "locked.yaml", "--world", "kinematic", "--out", "locked")
    assert done.returncode == 2
    assert "RuntimeError: the toy is locked" in " ".join(done.stderr.split())


def test_no_package_takes_the_place_of_a_way_to_a_controller_or_of_a_file(toy: Path) -> None:
    (toy / "mine.py").write_text("class Mine:\n    pass\n")
    for reference, message in (("exec:no-such-program", "no such program"), ("mine.py:Mine", "a method")):
        (toy / "own.yaml").write_text(DRIVEN.replace("toy:left", f'"{reference}"'))
        done = called(toy, "validate", "own.yaml")
        assert done.returncode == 2
        assert message in " ".join(done.stderr.split())
    assert "skipped safety_harness.controllers exec of toy 1.0: its name is taken" in done.stderr


def test_the_toys_section_is_on_the_page_of_a_run_and_one_that_fails_is_left_out(toy: Path) -> None:
    (toy / "shown.yaml").write_text(SHORT)
    done = called(toy, "run", "shown.yaml", "--world", "kinematic", "--out", "shown")
    page = (toy / "shown" / "report.html").read_text()
    assert '<h3 id="run-1-added-0">Toy &lt;wheels&gt;</h3>' in page
    assert "least &amp; last" in page
    assert "run-1-added-1" not in page
    assert "skipped safety_harness.page_sections failing: RuntimeError: no wheels" in done.stderr


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
def test_the_core_works_where_no_wing_is_installed(command: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "short.yaml").write_text(
        SHORT.partition("claims:")[0] + "claims:\n  trace finite and monotone: holds\n"
    )
    done = called(tmp_path, *command, code=WITHOUT_WINGS)
    assert (done.returncode, "warning: skipped" in done.stderr, "Traceback" in done.stderr) == (
        0,
        False,
        False,
    ), done.stderr
