"""One small page of each kind into reports/sample/, by the commands that users run.

Run: python benchmarks/sample_reports.py [KIND]...
"""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
OUT = ROOT / "reports" / "sample"
COMMANDS = {
    "run": "run scenarios/hand-visits-and-leaves.yaml scenarios/fast-reach.yaml",
    "fuzz": "fuzz scenarios/spaces/reaching-hands.yaml --budget 40",
    "evaluate": "evaluate optimum 'opposite pose' --questions 200 --search 0",
    "evidence": "certify plans/quick.yaml",
    "selftest": "selftest --scenarios shipped:scenarios --fault overspeed --jobs 2",
    "campaign": "campaign run plans/quick.yaml --ledger {out}/campaign.sqlite",
    "proof": "prove plans/student-proofs.yaml --minutes 0.5",
    "reproduction": "reproduce figure5 --scale quick",
}
KEPT, LEFT_OUT = (".html", ".json", ".md", ".sarif"), ("manifest.json", "certificate.json")
LARGEST_MB = 4.0


def main() -> int:
    """Make all of them; 1 if a command failed or they weigh too much."""
    for kind in sys.argv[1:] or COMMANDS:
        words = COMMANDS[kind]
        with tempfile.TemporaryDirectory() as folder:
            made = Path(folder) / kind
            asked = words.format(out=made) if "{out}" in words else f"{words} --out {made}"
            command = [sys.executable, "-m", "safety_harness", *shlex.split(asked)]
            print(f"{kind}: safety-harness {words}", flush=True)
            code = subprocess.run(command, cwd=ROOT, capture_output=True).returncode
            if code not in (0, 1):
                print(f"{kind}: ended with {code}")
                return 1
            shutil.rmtree(OUT / kind, ignore_errors=True)
            (OUT / kind).mkdir(parents=True)
            for file in sorted(path for path in made.iterdir() if path.suffix in KEPT):
                if file.name not in LEFT_OUT:
                    shutil.copy(file, OUT / kind / file.name)
    megabytes = sum(file.stat().st_size for file in OUT.rglob("*") if file.is_file()) / 1e6
    print(f"{megabytes:.1f} MB in {OUT}")
    return 0 if megabytes <= LARGEST_MB else 1


if __name__ == "__main__":
    sys.exit(main())
