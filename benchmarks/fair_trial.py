"""A fair trial: fourteen faults and sixty harmless changes, by evaluate and by fuzz --against.  Writes FAIR_TRIAL.md.

Each command is a line of reports/fair_trial.jsonl as soon as it has ended; what is there is not run again, so that
the whole may be stopped and started.  --table only writes the table.  One process at a time.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from fair_trial_avoiders import FAULTS, FILES, HARMLESS, make_file
from scipy.stats import beta

HERE, ROOT = Path(__file__).parent, Path(__file__).parents[1]
LINES, OUT = ROOT / "reports" / "fair_trial.jsonl", HERE / "FAIR_TRIAL.md"
SPACE = ROOT / "scenarios" / "spaces" / "reaching-hands.yaml"
ABOUT = {name: (one.about, one.of) for name, one in (FAULTS | HARMLESS).items()}
ABOUT |= {name: (about, of) for name, (about, of, _) in FILES.items()}
CLEAN = [*HARMLESS, *FILES]


def asked_of(name: str) -> str:
    """Say what --avoider takes."""
    if name in FILES:
        return str(make_file(name, ROOT / "reports" / "fair_trial"))
    return f"{HERE / 'fair_trial_avoiders.py'}:{name}" if name in ABOUT else name


def run_command(command: str, name: str, options: list[str], wall_s: float) -> dict[str, Any]:
    """Run one command in a process of its own, and read what it found."""
    with tempfile.TemporaryDirectory() as folder:
        avoider = asked_of(name)
        what = (
            [avoider]
            if command == "evaluate"
            else [str(SPACE), "--avoider", avoider, "--against", ABOUT[name][1]]
        )
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        process = subprocess.Popen(
            ["nice", "-n", "10", "safety-harness", command, *what, *options, "--out", folder],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        try:
            said, _ = process.communicate(timeout=wall_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGINT)
            said, _ = process.communicate()
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        result: dict[str, Any] = {
            "command": command,
            "name": name,
            "options": options,
            "exit": process.returncode,
        }
        result["cpu_s"] = round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 1)
        file = Path(folder) / ("evaluation.json" if command == "evaluate" else "findings.json")
        found = json.loads(file.read_text()) if file.exists() else {}
        if command == "evaluate":
            for one in found.get("avoiders", []):
                result["findings"] = [[f["kind"], f["region"], f["words"]] for f in one["findings"]]
                result["unlike"] = len(one["unlike_the_reference"])
        else:
            keys = (
                "counterexamples",
                "flips_near_the_limit",
                "distinct",
                "tried",
                "interrupted",
                "repeatability",
            )
            result |= {key: found.get(key) for key in keys}
            result["attribution"] = (found.get("attribution") or {}).get("words")
        result["tail"] = said[-2500:]
        return result


def flagged(row: dict[str, Any], references: dict[str, set[tuple[str, str]]]) -> list[str] | None:
    """Say what counts against it: unsafe findings that its reference has not, or counted differences."""
    if row["command"] == "evaluate":
        if "findings" not in row:
            return None
        known = references.get(ABOUT.get(row["name"], ("", ""))[1], set())
        return [f"{kind} ({region})" for kind, region, _ in row["findings"] if (kind, region) not in known]
    if row.get("distinct") is None or row["exit"] not in (0, 1):
        return None
    return [f"{one['complaint']}: {one['kind']}" for one in row["distinct"]] or (
        [f"exit code 1: {row['tail'].splitlines()[-1][:80]}"] if row["exit"] else []
    )


def table(rows: list[dict[str, Any]]) -> str:
    """Write the whole page."""
    references = {
        row["name"]: {(kind, region) for kind, region, _ in row.get("findings", [])}
        for row in rows
        if row["name"] not in ABOUT
    }
    by = {(row["command"], row["name"]): row for row in rows}
    text = [
        "# A fair trial",
        "",
        "Written by `python benchmarks/fair_trial.py`; the avoiders are in `fair_trial_avoiders.py`, written from the",
        "documents alone. *Flagged* is a finding of `evaluate`'s unsafe list that the unchanged reference has not, or a",
        "counted difference of `fuzz --against`. What was not measured is a dash, and is not counted.",
        "",
        "| command | faults noticed | missed | not measured | harmless flagged | upper bound, 95 % | processor time, median |",
        "|---|---|---|---|---|---|---|",
    ]
    for command in ("evaluate", "fuzz"):
        told = {n: flagged(by[command, n], references) for n in ABOUT if (command, n) in by}
        told = {name: one for name, one in told.items() if one is not None}
        named = [name for name in FAULTS if told.get(name)]
        missed = [name for name in FAULTS if name in told and not told[name]]
        clean, wrong = [n for n in CLEAN if n in told], [n for n in CLEAN if told.get(n)]
        bound = beta.ppf(0.95, len(wrong) + 1, len(clean) - len(wrong)) if len(wrong) < len(clean) else 1.0
        seconds = sorted(by[command, name]["cpu_s"] for name in told)
        text.append(
            f"| {command} | {len(named)} of {len(named) + len(missed)} | {', '.join(missed) or 'none'} | "
            f"{14 - len(named) - len(missed)} | {len(wrong)} of {len(clean)} | {bound:.1%} | "
            f"{seconds[len(seconds) // 2] if seconds else '–'} s |"
        )
    for title, names in (("Faults", list(FAULTS)), ("Harmless changes", CLEAN)):
        text += [
            "",
            f"## {title}",
            "",
            "| name | what | of | evaluate | fuzz --against |",
            "|---|---|---|---|---|",
        ]
        for name in names:
            cells = []
            for command in ("evaluate", "fuzz"):
                row = by.get((command, name))
                one = None if row is None else flagged(row, references)
                if one is None:
                    cells.append(
                        "–" if row is None else f"ended by {row['exit']} before a result ({row['cpu_s']} s)"
                    )
                else:
                    more = f" and {len(one) - 3} more" if len(one) > 3 else ""
                    flips = len(row.get("flips_near_the_limit") or [])
                    cells.append(
                        f"{'; '.join(one[:3]) or 'nothing'}{more}"
                        + (f"; {flips} flips" if flips else "")
                        + f" ({row['cpu_s']} s, {' '.join(row['options'])})"
                    )
            text.append(f"| {name} | {ABOUT[name][0]} | {ABOUT[name][1]} | {cells[0]} | {cells[1]} |")
    return "\n".join(text) + "\n"


def jobs(arguments: argparse.Namespace) -> list[tuple[str, str, list[str], float]]:
    """List every command, the cheapest to learn from first."""
    score, runs = ["--search", "0"], ["--budget", str(arguments.budget)]
    if arguments.questions:
        score += ["--questions", str(arguments.questions)]
    of = ("mc-dropout", "student", "ensemble", "opposite pose")
    every = [("evaluate", name, score, 300.0) for name in FAULTS]
    pairs = [[("fuzz", name, runs, 300.0), ("evaluate", name, score, 300.0)] for name in CLEAN]
    every += [("fuzz", name, runs, 400.0) for name in list(FAULTS)[:3]]
    every += (
        [one[0] for one in pairs]
        + [("evaluate", name, score, 300.0) for name in of]
        + [one[1] for one in pairs]
    )
    every += [("fuzz", name, runs, 400.0) for name in list(FAULTS)[3:]]
    return [
        one
        for one in every
        if arguments.only in (None, one[0]) and (not arguments.names or one[1] in arguments.names)
    ]


def main() -> None:
    """Run what has not been run, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--questions", type=int)
    parser.add_argument("--budget", type=int, default=120)
    parser.add_argument("--only", choices=("evaluate", "fuzz"))
    parser.add_argument("--table", action="store_true")
    arguments = parser.parse_args()
    LINES.parent.mkdir(exist_ok=True)
    rows = [json.loads(line) for line in LINES.read_text().splitlines()] if LINES.exists() else []
    for command, name, options, wall_s in [] if arguments.table else jobs(arguments):
        if not any((row["command"], row["name"]) == (command, name) for row in rows):
            rows.append(run_command(command, name, options, wall_s))
            with LINES.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
            print(command, name, rows[-1]["cpu_s"], rows[-1]["exit"], flush=True)
    OUT.write_text(table(rows))


if __name__ == "__main__":
    main()
