"""Commands of rholoc-lab, a distribution of its own: they are there where it is installed."""

from importlib.metadata import entry_points
from typing import Any

import typer
from typer.core import TyperGroup

from rholoc.errors import InvalidInput

_ENTRY_POINT = "rholoc.commands"
_NAMES = frozenset({"compare", "density", "evaluate", "evaluate-track", "flow", "paper", "simulate"})


def add_lab(*groups: typer.Typer) -> None:
    """Add the commands of rholoc-lab, if it is installed, to ``rholoc`` and its groups ``map`` and ``recording``."""
    for point in entry_points(group=_ENTRY_POINT):
        point.load()(*groups)


class CommandsOfTheLab(TyperGroup):
    """A group that says how to install a command of rholoc-lab that is missing."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the name, command and remaining arguments of ``args``, as every group does.

        Raises:
            InvalidInput: the command is one of rholoc-lab, which is not installed.
        """
        if args and args[0] in _NAMES and self.get_command(ctx, args[0]) is None:
            raise InvalidInput(
                f"`{ctx.command_path} {args[0]}` belongs to rholoc-lab, which is not installed.",
                "pip install rholoc-lab, or in a checkout pip install ./benchmarks/lab.",
            )
        return super().resolve_command(ctx, args)
