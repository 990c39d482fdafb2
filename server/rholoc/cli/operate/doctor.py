"""``rholoc doctor``: what is wrong with a server, and what to do."""

from dataclasses import asdict

import typer

from rholoc.cli.console import output, print_json
from rholoc.cli.operate.serve import Data, Maps, service_settings
from rholoc.cli.options import Json

_MARKS = {"ok": "ok     ", "warning": "warning", "error": "ERROR  "}


def doctor(maps: Maps = None, data: Data = None, as_json: Json = False) -> None:
    """Check storage, maps, jobs, clock, fonts, video codecs, libraries and settings; the server may run."""
    from rholoc.service.operate.doctor import Level, examine

    found = examine(service_settings(maps_dir=maps, data_dir=data))
    if as_json:
        print_json([asdict(finding) for finding in found])
    else:
        for finding in found:
            text = f"{_MARKS[finding.level]}  {finding.check}: {finding.message} {finding.hint}".rstrip()
            output.print(text, markup=False, soft_wrap=True)
    if any(finding.level is Level.ERROR for finding in found):
        raise typer.Exit(1)
