"""The pictures of README.md and docs/tutorials/first-run.md, from reports/sample: make sample first.

Run: python benchmarks/gallery.py
"""

from __future__ import annotations

import io
import sys
import tempfile
import time
from base64 import b64decode
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from browsing import show, started  # noqa: E402

OUT = ROOT / "docs" / "assets" / "gallery"
WIDTH_PX, COLOURS = 1000, 256
UNFOLD = "document.querySelectorAll('details.run').forEach((one) => { one.open = true; });"
REPLAY = f"{UNFOLD} document.querySelector('.replay').scrollIntoView();"
FAILURE = f"""{UNFOLD} const last = [...document.querySelectorAll('.replay')].at(-1); last.scrollIntoView();
const worst = [...last.querySelectorAll('button')].find((one) => one.innerText === 'Worst moment');
setTimeout(() => worst.click(), 2000);"""
COVERAGE = "document.querySelector('#coverage').scrollIntoView();"
PICTURES = {
    "run": ("run/report.html", "light", ""),
    "replay": ("run/report.html", "light", REPLAY),
    "failure": ("run/report.html", "light", FAILURE),
    "fuzz": ("fuzz/fuzz.html", "light", ""),
    "coverage": ("fuzz/fuzz.html", "light", COVERAGE),
    "evidence": ("evidence/evidence.html", "light", ""),
    "evidence-dark": ("evidence/evidence.html", "dark", ""),
    "evaluate": ("evaluate/evaluation.html", "light", ""),
    "selftest": ("selftest/selftest.html", "light", ""),
}


def main() -> None:
    """Take and write all of them."""
    OUT.mkdir(exist_ok=True, parents=True)
    with tempfile.TemporaryDirectory() as profile:
        browser = started(Path(profile))
        for name, (page, scheme, script) in PICTURES.items():
            show(browser, (ROOT / "reports" / "sample" / page).as_uri(), width=WIDTH_PX, scheme=scheme)
            browser.execute_script(script)
            time.sleep(4.0 if "replay" in script else 1.0)
            clip = {"format": "png", "captureBeyondViewport": False}
            data = browser.execute_cdp_cmd("Page.captureScreenshot", clip)["data"]
            picture = Image.open(io.BytesIO(b64decode(data))).convert("RGB")
            file = OUT / f"{name}.png"
            picture.quantize(COLOURS).save(file, optimize=True)
            print(f"{file.relative_to(ROOT)}: {file.stat().st_size / 1e3:.0f} kB", flush=True)
        browser.quit()


if __name__ == "__main__":
    main()
