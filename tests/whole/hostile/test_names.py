"""Names and texts of files that are markup, commands to a terminal or ways out of a folder."""

from __future__ import annotations

import json
import os
from html.parser import HTMLParser
from pathlib import Path

import pytest

from safety_harness.base.exceptions import InputError
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.cli.scenario_commands import run
from safety_harness.scenario.read import read_scenario
from safety_harness.space.read import read_space
from tests.whole.hostile.formats import SCENARIO, SPACE

MARKUP = "<img src=x onerror=alert(1)>"
BAD_NAMES = [
    "two\nlines",
    "\x1b[31mred",
    "bell\x07",
    "right\u202eleft",
    "\udcff",
    "x" * 200,
    "zero\u200bwidth",
]


@pytest.mark.parametrize("name", BAD_NAMES, ids=ascii)
@pytest.mark.parametrize(("read", "text"), [(read_scenario, SCENARIO), (read_space, SPACE)])
def test_a_file_with_such_a_name_is_refused(
    read: object, text: str, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / os.fsdecode(os.fsencode(f"{name}.yaml"))
    path.write_text(text)
    with pytest.raises(InputError, match="a file with a name of printable characters") as caught:
        read(path)  # type: ignore[operator]
    assert str(caught.value).isprintable()
    assert run([path], tmp_path / "out") == BAD_INPUT
    out, err = capsys.readouterr()
    assert (out + err).replace("\n", "").isprintable()
    assert not (tmp_path / "out").exists()


class Elements(HTMLParser):
    """The elements of a page that could do something, and what is in the scripts."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.handlers: list[str] = []
        self.images: list[str] = []
        self.scripts = ""
        self._script = False
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._script = tag == "script"
        self.handlers += [name for name, _ in attrs if name.startswith("on")]
        self.images += [value or "" for name, value in attrs if tag == "img" and name == "src"]

    def handle_data(self, data: str) -> None:
        if self._script:
            self.scripts += data

    def handle_endtag(self, tag: str) -> None:
        self._script = False


def test_markup_in_a_name_or_a_text_stays_text(tmp_path: Path) -> None:
    hostile = f"'</script><script>alert(2)</script> {MARKUP} {{{{7*7}}}} %s {{0}}'"
    text = SCENARIO.replace("a short run\n", f"{hostile}\nabout: {hostile}\n")
    for name in (MARKUP, "..", "-rf %s {0} quote'\"$(true)`true`#1"):
        (tmp_path / f"{name}.yaml").write_text(text)
    assert run([tmp_path], tmp_path / "out", "opposite pose") == AS_EXPECTED
    page = (tmp_path / "out" / "report.html").read_text()
    elements = Elements(page)
    assert not elements.handlers
    assert all(source.startswith("data:") for source in elements.images)
    assert "alert(" not in elements.scripts
    assert "{{7*7}}" in page
    assert "49" not in page.partition("{{7*7}}")[2][:3]
    written = json.loads((tmp_path / "out" / "report.json").read_text())
    assert MARKUP in {one["scenario"] for one in written["runs"]}
    there = {path.name for path in (tmp_path / "out" / "traces").iterdir()}
    assert f"{MARKUP}.trace" in there
    assert {path.name for path in tmp_path.iterdir() if path.suffix != ".yaml"} == {"out"}


@pytest.mark.parametrize(
    "reference",
    ["~nobody-at-all/mine.py:Mine", "loop.py:Mine", "/dev/zero:Mine", "pipe.py:Mine", "huge.py:Mine"],
)
def test_an_avoider_named_so_is_refused_at_once(
    reference: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.yaml").write_text(SCENARIO)
    Path("loop.py").symlink_to("loop.py")
    os.mkfifo("pipe.py")
    Path("huge.py").touch()
    os.truncate("huge.py", 1 << 40)
    assert run([Path("s.yaml")], Path("out"), reference) == BAD_INPUT
    assert "Traceback" not in capsys.readouterr().err
