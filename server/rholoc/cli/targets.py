"""Check that an output file can be written before the work begins."""

from __future__ import annotations

import os
from pathlib import Path

from rholoc.errors import InvalidInput


def check_target(path: Path, what: str) -> Path:
    """Return the path after checking that a file for ``what`` can be written there.

    Raises:
        InvalidInput: its folder does not exist or is not writable, or it is a folder itself.
    """
    if not path.parent.is_dir():
        raise InvalidInput(f"There is no folder {path.parent} to write {what} to.", "Create it first.")
    if path.is_dir():
        raise InvalidInput(f"{path} is a folder.", f"Name a file to write {what} to, in it or elsewhere.")
    if not os.access(path.parent, os.W_OK):
        raise InvalidInput(f"The folder {path.parent} cannot be written to.", "Choose another, or allow it.")
    return path


def is_bag_target(path: Path) -> bool:
    """Whether poses that are written to a path are a bag of ROS 2 (``.mcap``), not a table, after checking the path.

    Raises:
        InvalidInput: it cannot be written there, or is a bag of another kind.
    """
    check_target(path, "the poses")
    suffix = path.suffix.lower()
    if suffix in (".bag", ".db3"):
        raise InvalidInput(f"Bags are written as .mcap, not as {suffix}.", f"Name it {path.stem}.mcap.")
    return suffix == ".mcap"
