"""The command tree, and error reports: one line and an exit status, never a traceback."""

import os
import sys
from typing import Annotated

import typer

from rholoc import __version__
from rholoc.cli import cameras, demo, localize, maps, recordings, sites, track
from rholoc.cli.console import print_error
from rholoc.cli.lab import CommandsOfTheLab, add_lab
from rholoc.cli.operate import backup, doctor, jobs, keys, serve
from rholoc.disk import is_full
from rholoc.errors import RholocError

EXIT_ERROR = 1
EXIT_INTERRUPTED = 130
_OF_MAPPING = frozenset({"gtsam", "matplotlib", "poselib", "pycolmap"})
DEBUG_VARIABLE = "RHOLOC_DEBUG"  # if set, bugs are shown with their traceback

app = typer.Typer(
    name="rholoc",
    cls=CommandsOfTheLab,
    help="Indoor localization from ordinary cameras: one walk with a phone makes a map, any frame gets its pose back.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(demo.demo)
app.command()(serve.serve)
app.command()(serve.worker)
app.command()(backup.backup)
app.command()(backup.restore)
app.command()(doctor.doctor)
app.command()(keys.audit)
app.add_typer(maps.app, name="map")
app.add_typer(cameras.app, name="camera")
app.add_typer(sites.app, name="site")
app.add_typer(recordings.app, name="recording")
app.add_typer(keys.app, name="key")
app.add_typer(jobs.app, name="job")
app.add_typer(backup.storage_app, name="storage")
app.command()(localize.localize)
app.command()(track.track)
app.command()(track.watch)
add_lab(app, maps.app, recordings.app)


def _print_version(asked: bool) -> None:
    """Print the version and exit, if asked to."""
    if asked:
        typer.echo(f"rholoc {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command: exit status 0, 1 after an error, 2 after wrong usage, 130 after Ctrl-C.

    Errors become a line on standard error; only bugs are raised, and only if ``DEBUG_VARIABLE`` is set.
    """
    try:
        app()
    except RholocError as error:
        print_error(error.message, error.hint)
        sys.exit(EXIT_ERROR)
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)
    except BrokenPipeError:
        # The reader of our output has gone; what Python still has to flush there must not raise again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(EXIT_ERROR)
    except OSError as error:
        print_error(*_os_error(error))
        sys.exit(EXIT_ERROR)
    except ModuleNotFoundError as error:
        print_error(*_missing(error))
        sys.exit(EXIT_ERROR)
    except Exception as error:
        if os.environ.get(DEBUG_VARIABLE):
            raise
        print_error(f"rholoc itself failed: {type(error).__name__}: {error}.", f"{DEBUG_VARIABLE}=1 shows where.")
        sys.exit(EXIT_ERROR)


def _missing(error: ModuleNotFoundError) -> tuple[str, str]:
    """Message and hint for a command that needs a missing library: the extra that has it."""
    extra = "mapping" if error.name in _OF_MAPPING else "server"
    return f"This command needs {error.name}, which is not installed.", f"pip install 'rholoc[{extra}]'."


def _os_error(error: OSError) -> tuple[str, str]:
    """Message and hint for an error of the operating system; the message names the file, if any."""
    what = (error.strerror or str(error)).rstrip(".")
    message = f"{what}: {error.filename}." if error.filename else f"{what}."
    if is_full(error):
        return message, "Free some space and run it again."
    return message, "Check the path and its permissions."
