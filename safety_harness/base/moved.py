"""Old import paths of documented names, supported for one release.

An old path imports the module at its new place.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

PACKAGE = "safety_harness"
MOVED = {
    "attribution.attribute": "extensions.attribution.attribute",
    "report.html": "extensions.pages.run_page",
    "report.page_parts": "extensions.pages.page_parts",
    "search.attribution": "extensions.attribution",
    "search.attribution.attribute": "extensions.attribution.attribute",
    "avoidance.avoider": "cell.avoidance.avoider",
    "avoidance.model_file": "cell.avoidance.model_file",
    "controller.contract": "seams.contract",
    "claims.formulas.signal": "claims.signals.signal",
    "exceptions": "base.exceptions",
    "formulas.claim": "claims.formulas.claim",
    "formulas.language": "claims.formulas.language",
    "formulas.parse": "claims.formulas.parse",
    "gym": "extensions.gym",
    "gym.environment": "extensions.gym.environment",
    "gym.stable_baselines": "extensions.gym.stable_baselines",
    "gym.vector": "extensions.gym.vector",
    "logs.model": "extensions.field.logs.model",
    "logs.read": "extensions.field.logs.read",
    "properties.base": "claims.properties.base",
    "properties.spread_calibration": "claims.properties.spread_calibration",
    "settings": "base.settings",
    "simulation.worlds": "cell.simulation.worlds",
}
STAYED = {"claims", "report", "search"}  # packages of which only parts moved
_TOPS = {name.partition(".")[0] for name in MOVED} - STAYED


class _FromNewPlace(Loader):
    """The loader for an old path.

    The loader loads the module at the new place. If the old path is a package of which all modules have
    moved, the loader creates an empty package.
    """

    def __init__(self, new: str) -> None:
        self._new = new

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """Return None, so that Python itself creates the module."""
        return None

    def exec_module(self, module: ModuleType) -> None:
        """Register the module from the new place in ``sys.modules`` under the old name."""
        if self._new:
            sys.modules[module.__name__] = import_module(f"{PACKAGE}.{self._new}")


class MovedModules(MetaPathFinder):
    """The finder for the old paths in ``MOVED``.

    The finder raises an error for any other path below an old package.
    """

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the spec of a moved module.

        Raise ModuleNotFoundError for any other module of an old package.
        """
        package, _, old = fullname.partition(".")
        if package != PACKAGE or (old not in MOVED and old.partition(".")[0] not in _TOPS):
            return None
        if old not in MOVED and old not in _TOPS:
            raise ModuleNotFoundError(
                f"No module named {fullname!r}: CHANGELOG.md says where it is", name=fullname
            )
        return ModuleSpec(fullname, _FromNewPlace(MOVED.get(old, "")), is_package=old in _TOPS)


sys.meta_path.insert(0, MovedModules())
