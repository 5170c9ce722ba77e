#!/usr/bin/env python3
"""Run uv with pip's settings, which uv does not read.

    .venv-uv/bin/python .ci/uv.py ARGUMENTS

These are its indexes, folders of wheels, constraints and certificates.  "make" installs with uv, which takes
a third of pip's time.
"""

import ast
import os
import subprocess
import sys
from pathlib import Path

# The separator of several values, where pip takes spaces or lines.
SETTINGS = {
    "index-url": ("UV_DEFAULT_INDEX", " "),
    "extra-index-url": ("UV_INDEX", " "),
    "find-links": ("UV_FIND_LINKS", ","),
    "constraint": ("UV_CONSTRAINT", " "),
    "cert": ("SSL_CERT_FILE", " "),
}
ORDER = ("global", "site", "user", "install", ":env:")  # later ones win


def of_pip() -> dict[str, str]:
    """Pip's settings as variables of uv."""
    listed = subprocess.check_output([sys.executable, "-m", "pip", "config", "list"], text=True)
    rows = [line.partition("=") for line in listed.splitlines()]
    named = [(*name.rpartition(".")[::2], ast.literal_eval(value)) for name, _, value in rows]
    named.sort(key=lambda row: ORDER.index(row[0]) if row[0] in ORDER else -1)
    return {
        SETTINGS[name][0]: SETTINGS[name][1].join(str(value).split())
        for _, name, value in named
        if name in SETTINGS
    }


def main(arguments: list[str]) -> None:
    """Replace this process by uv; what is set for uv itself stays."""
    # Pip looks for the best version in all indexes, uv in the first that has the package.
    environment = {"UV_INDEX_STRATEGY": "unsafe-best-match"} | of_pip() | os.environ
    uv = str(Path(sys.executable).with_name("uv"))
    os.execve(uv, [uv, *arguments], environment)


if __name__ == "__main__":
    main(sys.argv[1:])
