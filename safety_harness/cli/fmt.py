"""Define ``safety-harness fmt``, which writes scenario files in the standard layout."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from safety_harness.base.exceptions import InputError, Place, ScenarioError
from safety_harness.base.whole_file import write_text
from safety_harness.claims.properties.catalogue import in_words_of_today
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS, document, explain, result, say
from safety_harness.scenario.compose import MAX_BYTES, tree_of
from safety_harness.scenario.files import decode, read_bytes
from safety_harness.scenario.kinds import FileKind, refuse_other_kind
from safety_harness.scenario.layout import laid_out
from safety_harness.scenario.modern import modernised
from safety_harness.scenario.ours import aside_lines, files_of

FORMATTED_KINDS = (FileKind.SCENARIO, FileKind.SPACE, FileKind.SUITE, FileKind.PLAN)


def format_files(paths: Sequence[Path], *, check: bool, modernise: bool = False) -> int:
    """Change every file to the standard layout, and return the exit code.

    If ``check`` is true, only print the files that would change.  If ``modernise`` is true, the function also
    replaces keys and claims of earlier releases by the present ones.
    """
    changed, failed = list[Path](), False
    for path in paths:
        try:
            files, aside = files_of(path, FORMATTED_KINDS)
            say(*aside_lines(aside))
            for file in files:
                changed += [file] * _format(file, check=check, modernise=modernise)
        except InputError as error:
            explain(error)
            failed = True
    document(changed=changed)  # with --check, the files that would change
    if failed:
        return BAD_INPUT
    return DIFFERS if check and changed else AS_EXPECTED


def _format(file: Path, *, check: bool, modernise: bool) -> bool:
    """Change one file to the standard layout, and return whether this changes the file.

    If ``check`` is true, the file stays unchanged.
    """
    refuse_other_kind(file, *FORMATTED_KINDS)
    data = read_bytes(file, most=MAX_BYTES, place=Place(file=file), error=ScenarioError)
    old_text = decode(data, most=MAX_BYTES, file=file, error=ScenarioError)
    tree_of(old_text, file)  # refuses other files
    text = laid_out(modernised(old_text, in_words_of_today, file) if modernise else old_text, file)
    if text.encode() == data:
        return False
    if not check:
        write_text(file, text)
    result(f"{'would change' if check else 'changed'} {file}")
    return True
