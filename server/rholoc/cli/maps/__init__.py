"""``rholoc map``: builds maps, makes them learn and forget, inspects and exports them."""

import typer

from rholoc.cli.lab import CommandsOfTheLab
from rholoc.cli.maps import build, correct, exchange, show

app = typer.Typer(
    no_args_is_help=True, cls=CommandsOfTheLab, help="Build maps, make them learn and forget, inspect and export them."
)
app.add_typer(correct.app, name="correct")
app.command()(build.build)
app.command("list")(show.list_maps)
app.command()(show.info)
app.command()(build.update)
app.command()(build.learn)
app.command()(build.queries)
app.command()(build.merge)
app.command()(build.forget)
app.command()(exchange.export)
app.command("import")(exchange.import_)
app.command()(show.report)
