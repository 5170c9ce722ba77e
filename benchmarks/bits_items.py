"""What ``bits.py`` compares: command lines, each quick or only of the whole form."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Item:
    """Something to compare: the arguments of a command.

    "{out}" is the folder that it writes, "{earlier}" a folder of files of earlier revisions, and "{plan}" a
    file with the text of ``plan``.
    """

    name: str
    command: str
    quick: bool = True
    plan: str = ""


QUICK_SCENARIOS: Final = re.sub(
    r"([\w-]+)\s*",
    r"scenarios/\1.yaml ",
    """
    another-object-elsewhere between-two-hands box-beside-the-way camera-30-hz carrying-a-board cornered
    decisions-take-90-ms eye-in-hand-sees fault-avoider-answers-nan fault-camera-late fault-joint-stuck
    hand-returns hand-visits-and-leaves hidden-by-the-arm network-in-doubt object-stays-lost own-formulas
    overhead-camera proven-region recorded-handover robot-panda robot-ur5 second-hand stops-in-time
    tilted-start trembling-hand wrong-hand-eye-calibration
    """,
)
QUICK_SPACES: Final = ("nominal", "recorded-variations")
SPACES: Final = (*QUICK_SPACES, "reaching-hands", "unseen-both", "unseen-hand", "unseen-tcp")
TINY_PLAN: Final = """
plan: a few runs
avoider: mc-dropout
world: kinematic
seed: 1
strata:
  - stratum: seen
    space: ../../source/scenarios/spaces/nominal.yaml
    runs: 12
  - stratum: unseen hand and TCP
    space: ../../source/scenarios/spaces/unseen-both.yaml
    runs: 12
claims:
  - claim: hand distance never below 50 mm
    violated in at most: 50 %
  - claim: repulsive poses reachable
  - claim: TCP speed never above 250 mm/s
keep:
  random traces: 1
  violations: 1
"""
TINY_PROOF: Final = """
proof: a small region
avoider: student
regions:
  beside:
    hand: {from: [540 mm, -650 mm, -295 mm], to: [1140 mm, -280 mm, 305 mm]}
    tcp: {from: [640 mm, -150 mm, 250 mm], to: [760 mm, -40 mm, 450 mm]}
    apart: [100 mm, 400 mm]
claims:
  - claim: steps at most 150 mm
    in: beside
  - claim: leads away
    in: beside
distribution:
  samples: 500
  confidence: 99 %
"""
ITEMS: Final = (  # what takes long first, since two run at a time
    Item("quick scenarios, PyBullet", f"run {QUICK_SCENARIOS} --jobs 1 --keep-going --out {{out}}"),
    *(
        Item(f"short search of {name}", f"fuzz scenarios/spaces/{name}.yaml --budget 30 --out {{out}}")
        for name in QUICK_SPACES
    ),
    Item(
        "quick scenarios, kinematic",
        f"run {QUICK_SCENARIOS} --world kinematic --jobs 1 --keep-going --out {{out}}",
    ),
    Item("two faults", "selftest --scenarios shipped:scenarios --fault stale --jobs 1 --out {out}"),
    Item("tiny plan", "certify {plan} --workers 1 --out {out}", plan=TINY_PLAN),
    Item("small proof", "prove {plan} --halvings 4 --minutes 30 --out {out}", plan=TINY_PROOF),
    Item("score", "evaluate mc-dropout student --questions 20 --search 0 --out {out}"),
    Item("traces of earlier versions", "judge {earlier}/*.trace --json"),
    Item("report of an earlier version", "verify {earlier}/57e81b3 --runs 0 --json"),
    Item("ledger of an earlier version", "campaign status {earlier}/57e81b3/ledger.sqlite --json"),
    Item("claims", "claims --json"),
    Item("schema", "schema"),
    Item("shipped", "list"),
    Item("validity", "validate scenarios --json", False),
    Item("a file of another kind", "run plans/quick.yaml"),
    Item(
        "all scenarios, kinematic", "run scenarios --world kinematic --keep-going --jobs 1 --out {out}", False
    ),
    Item("all scenarios, PyBullet", "run scenarios --jobs 1 --out {out}", False),
    *(
        Item(f"search of {name}", f"fuzz scenarios/spaces/{name}.yaml --budget 100 --out {{out}}", False)
        for name in SPACES
    ),
    Item("plan quick", "certify plans/quick.yaml --workers 1 --out {out}", False),
    Item("plan certify-in-a-minute", "certify plans/certify-in-a-minute.yaml --workers 1 --out {out}", False),
    Item("long score", "evaluate optimum student --questions 200 --search 0 --out {out}", False),
    # Enough minutes for all halvings, or the speed of the machine would decide.
    Item(
        "proofs of the student",
        "prove plans/student-proofs.yaml --halvings 12 --minutes 60 --out {out}",
        False,
    ),
    Item(
        "proofs of the ensemble",
        "prove plans/student-ensemble-proofs.yaml --halvings 12 --minutes 60 --out {out}",
        False,
    ),
    Item("self-test", "selftest --scenarios shipped:scenarios --jobs 1 --out {out}", False),
)

# Runs in a process of the revision: help and exit codes of every command line, and the names at the root.
ASK: Final = r"""
import contextlib, inspect, io, json, pathlib, re, runpy, sys

def ask(*words):
    out, code = io.StringIO(), 0
    sys.argv = ["safety-harness", *words]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
        try:
            runpy.run_module("safety_harness", run_name="__main__")
        except SystemExit as end:
            code = end.code or 0
    return code, out.getvalue()

commands, waiting = {}, [()]
while waiting:
    words = waiting.pop()
    code, text = ask(*words, "--help")
    inner = re.findall(r"^  ([a-z][a-z-]*) ", text.partition("\nCommands:\n")[2], re.M)
    waiting += [(*words, name) for name in inner]
    found = commands[" ".join(words)] = {"exit code of help": code, "help": text}
    found["options"] = sorted(set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", text)))
    if not inner:
        found["exit code for a file that is not there"] = ask(*words, "README.md/no-file.yaml")[0]

import safety_harness
names, sources = {}, pathlib.Path(safety_harness.__file__).parent.rglob("*.py")
formats = set(re.findall(r'"(safety-harness [a-z ]+ [0-9]+)"', "".join(file.read_text() for file in sources)))
for name in sorted(safety_harness.__all__):
    value = getattr(safety_harness, name)
    with contextlib.suppress(TypeError, ValueError):
        names[f"parameters of {name}"] = re.sub(r" at 0x\w+| ", "", str(inspect.signature(value)))
    names[f"kind of {name}"] = type(value).__name__
json.dump({"number of command lines": len(commands),
           "commands": commands, "names": names, "formats": sorted(formats)}, sys.stdout)
"""
