"""Child process for long exports: it can be killed, and localization does not wait for it.

One JSON object on the standard input says what to export; the file comes out on the standard output. What the map or an
option does not allow is one JSON object on the standard error, with exit status 3.
"""

import json
import sys
from pathlib import Path

from rholoc.errors import RholocError
from rholoc.exports.formats import ExportFormat, export_map
from rholoc.maps import load_map

REFUSED = 3  # exit status


def main() -> int:
    """Write the export that standard input asks for to standard output; returns the exit status, 0 or ``REFUSED``."""
    wanted = json.loads(sys.stdin.buffer.readline())
    try:
        map_ = load_map(Path(wanted["source"]), wanted["title"])
        for piece in export_map(
            map_,
            ExportFormat(wanted["format"]),
            title=wanted["title"],
            degree=wanted["degree"],
            features=wanted["features"],
        ):
            sys.stdout.buffer.write(piece)
        sys.stdout.buffer.flush()
    except RholocError as error:
        refusal = {"code": error.code, "message": error.message, "hint": error.hint}
        sys.stderr.write(json.dumps(refusal) + "\n")
        return REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main())
