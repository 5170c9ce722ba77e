"""The journal of the files that a user's module opens: what the module itself writes there hides none."""

from __future__ import annotations

import os

from safety_harness.seams.isolation.opened import environment, noted

MODULE, FILE = "a" * 64, "b" * 64


def test_noise_hides_no_file() -> None:
    _, journal = environment()
    begin = noted(0)[1]
    for line in (
        "\udcff\udcfe\n",
        "no such line\n",
        f"noise\udcff{MODULE} {FILE} /a b\n",
        f"{MODULE}  /own\n",
        "cut",
    ):
        os.write(journal, os.fsencode(line))
    found, end = noted(begin)
    assert found == [(MODULE, "/a b", FILE), (MODULE, "/own", "")]
    os.write(journal, b" off\n")
    assert noted(end) == ([], end + len("cut off\n"))
