"""Rules for the names of maps, cameras and sites."""

import re
from collections.abc import Sequence

from rholoc.errors import InvalidName

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}")
_NAMES_SHOWN = 5
_ALL = "all"


def is_name(name: str) -> bool:
    """Whether a name is valid: 1–64 letters, digits, ``.``, ``_``, ``-``, not beginning with ``.`` or ``-``."""
    return _NAME.fullmatch(name) is not None


def is_map_name(name: str) -> bool:
    """Whether a map may have this name. ``all`` is reserved: it stands for all maps."""
    return is_name(name) and name != _ALL


def check_name(name: str, what: str) -> str:
    """Return the name, checked; error messages call it a ``what``.

    Raises:
        InvalidName: it is not valid.
    """
    if not is_name(name):
        shown = name if len(name) <= 64 else name[:61] + "…"
        raise InvalidName(
            f"{shown!r} is not a valid {what} name.",
            "Use 1 to 64 letters, digits, '.', '_' and '-', the first a letter, a digit or '_'.",
        )
    return name


def check_map_name(name: str) -> str:
    """Return the name of a map, checked.

    Raises:
        InvalidName: it is not valid, or ``all``.
    """
    if name == _ALL:
        raise InvalidName(f"A map cannot be named {name}: that means all maps.", "Choose another name.")
    return check_name(name, "map")


def some_of(names: Sequence[str]) -> str:
    """The first five names, separated by commas, and "…" if there are more."""
    return ", ".join(names[:_NAMES_SHOWN]) + (", …" if len(names) > _NAMES_SHOWN else "")
