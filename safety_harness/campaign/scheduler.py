"""Finding a Dask scheduler: by its address or in the file that it has written."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

from safety_harness.exceptions import InputError, Place, ScenarioError


def connected(where: str, timeout_s: float) -> Any:
    """A ``distributed.Client`` of the scheduler at an address (tcp://...) or in a file.

    InputError if none answers within ``timeout_s``.
    """
    try:
        from distributed import Client
    except ImportError:
        raise ScenarioError(
            place=Place(field="--cluster"),
            expected="the library distributed",
            got="none",
            hint="pip install 'safety-harness[cluster]'",
        ) from None
    make: Any = Client  # of whose methods some have no types
    try:
        address = where if "://" in where else _address_in(Path(where))
        asyncio.run(_refuse_no_scheduler(address, timeout_s))
        return make(address=address, timeout=timeout_s, set_as_default=False)
    except Exception as error:  # whatever listens there may answer anything
        raise _none(where, error) from error


def _address_in(file: Path) -> str:
    """What a scheduler has written, at once: Dask would wait for a file that is not there."""
    try:
        address = json.loads(file.read_text(encoding="utf-8"))["address"]
    except FileNotFoundError:
        raise FileNotFoundError("no such file") from None
    except (KeyError, TypeError, UnicodeDecodeError, json.JSONDecodeError):
        raise ValueError("a file that no scheduler has written") from None
    return str(address)


async def _refuse_no_scheduler(address: str, timeout_s: float) -> None:
    """Shake hands: a Client waits for ever where something takes a connection and is no scheduler."""
    from distributed.comm.core import connect

    shake_hands: Any = connect  # which has no types
    try:
        comm = await asyncio.wait_for(shake_hands(address, timeout=timeout_s / 2.0), timeout_s)
    except TimeoutError:
        raise TimeoutError(f"no answer within {timeout_s:g} s") from None
    comm.abort()


def _none(where: str, error: Exception) -> InputError:
    return ScenarioError(
        place=Place(field="--cluster"),
        expected="the address (tcp://...) or the file of a Dask scheduler that answers",
        got=f"{where}: {str(error) or type(error).__name__}",
    )
