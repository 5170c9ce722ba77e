"""The one step of a build that pyproject.toml has no words for: the wheel holds what is shipped.

Scenarios, plans, robots and examples lie beside the package in the repository, where tests and documents name
them; a mapping of packages to these folders would cost the editable install its plain path.  Of ``docs`` it
holds the Markdown.  ``site`` is what ``make docs`` built, if it did, and ``machine_code`` what
``.ci/machine_code.py`` compiled.
"""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

FOLDERS = ("scenarios", "plans", "examples", "robots", "docs", "site")
CODE = "machine_code"
MADE_OF_DOCS = ("*.py", "*.json", "assets", "schema")  # they serve the build of the site


class BuildWithContents(build_py):
    """Copies the folders below safety_harness/base/shipped; an editable install finds them where they are."""

    def run(self) -> None:
        """As always, and the folders, without what an earlier build left there."""
        super().run()
        if self.editable_mode:
            return
        package = Path(self.build_lib, "safety_harness")
        copies = {folder: package / "base" / "shipped" / folder for folder in FOLDERS}
        for folder, copy in (copies | {CODE: package / CODE}).items():
            shutil.rmtree(copy, ignore_errors=True)
            if Path(folder).is_dir():
                left_out = ("__pycache__", ".*", *(MADE_OF_DOCS if folder == "docs" else ()))
                shutil.copytree(folder, copy, ignore=shutil.ignore_patterns(*left_out))


setup(cmdclass={"build_py": BuildWithContents})
