"""The commands that rholoc-lab adds to ``rholoc``."""

import typer

from rholoc_lab.commands import compare, density, evaluate, evaluate_track, flow, paper, simulate


def add_commands(app: typer.Typer, maps: typer.Typer, recording: typer.Typer) -> None:
    """Add the commands of rholoc-lab to ``rholoc`` and to its groups ``map`` and ``recording``."""
    app.command()(simulate.simulate)
    app.add_typer(paper.app, name="paper")
    app.command()(evaluate_track.evaluate_track)
    app.command()(evaluate.evaluate)
    app.command()(compare.compare)
    maps.command()(density.density)
    recording.command()(flow.flow)
