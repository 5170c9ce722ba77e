"""The page on paper: printed to PDF by an installed Chromium or Chrome, which is found on the path."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from safety_harness.exceptions import InputError, OutputError, Place

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
LIMIT_S = 180.0


def browser() -> str:
    """The browser that prints; InputError if there is none."""
    for name in BROWSERS:
        found = shutil.which(name)
        if found is not None:
            return found
    raise InputError(
        place=Place(field="--pdf"),
        expected="an installed Chromium or Chrome, which prints the page",
        got="none of " + ", ".join(BROWSERS) + " on the path",
        hint="the page itself prints well from any browser",
    )


def write_pdf(page: Path, path: Path) -> None:
    """Print ``page`` to ``path``; OutputError with what the browser said if it does not."""
    with tempfile.TemporaryDirectory() as profile:
        command = [
            browser(),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
            "--disable-background-networking",
            "--no-pdf-header-footer",
            f"--user-data-dir={profile}",
            f"--print-to-pdf={path.resolve()}",
            page.resolve().as_uri(),
        ]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
        except subprocess.TimeoutExpired as error:
            raise _failed(path, f"the browser did not finish in {LIMIT_S:.0f} s") from error
    if done.returncode != 0 or not path.is_file():
        raise _failed(path, done.stderr.strip().splitlines()[-1] if done.stderr.strip() else "nothing")
    with path.open("rb") as file:
        if file.read(5) != b"%PDF-":
            raise _failed(path, "no PDF")


def _failed(path: Path, said: str) -> OutputError:
    return OutputError(place=Place(file=path), expected="a PDF that the browser prints", got=said[:200])
