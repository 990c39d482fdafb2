"""Holds the licences of an environment's packages, as their own metadata say, to what the README says of them.

    .venv/bin/python .ci/licences.py ENVIRONMENT/bin/python

What binary wheels contain beside their own code is not in the metadata: what is known of that is listed here, and in
the README, too.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator

PERMISSIVE = {
    "0BSD",
    "Apache Software License",
    "Apache-2.0",
    "BSD 3-Clause License",
    "BSD License",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "CC0-1.0",
    "ISC License (ISCL)",
    "MIT",
    "MIT License",
    "MIT-0",
    "MIT-CMU",
    "PSF-2.0",
    "Python Software Foundation License",
    "Zlib",
}
OTHERS = {  # each named in the README's section on licences
    "apsw": "any-OSI",
    "certifi": "Mozilla Public License 2.0 (MPL 2.0)",
    "psycopg": "LGPL-3.0-only",
    "psycopg-binary": "LGPL-3.0-only",
}
CONTAINED = {  # in binary wheels, under other terms than the package's own; each named in the README
    "faiss-cpu": "libquadmath (LGPL)",
    "numpy": "libquadmath (LGPL)",
    "opencv-python-headless": "FFmpeg and libquadmath (LGPL)",
    "psycopg-binary": "keyutils (LGPL)",
    "pycolmap": "SuiteSparse's SPQR and supernodal CHOLMOD (GPL-2.0-or-later), libquadmath (LGPL)",
    "scipy": "libquadmath (LGPL)",
}


def licences(python: str) -> dict[str, str]:
    """The licence of every package of an environment; of a whole text its first line."""
    command = [sys.executable, "-m", "piplicenses", f"--python={python}", "--from=mixed", "--format=json"]
    listed = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return {package["Name"]: package["License"].splitlines()[0] for package in listed}


def is_permissive(licence: str) -> bool:
    """Whether all parts of an expression are: of ``OR`` one choice is enough; ``AND`` and ``;`` join parts."""
    parts = [part.split(" OR ") for part in re.split(r" AND |;", licence)]
    return all(any({choice.strip(), choice.strip(" ()")} & PERMISSIVE for choice in part) for part in parts)


def problems(found: dict[str, str]) -> Iterator[str]:
    """What the README does not say, or says wrongly, of an environment's licences."""
    for name, licence in found.items():
        if not (licence == OTHERS[name] if name in OTHERS else is_permissive(licence)):
            yield f"{name}: '{licence}' is not a licence that the README and .ci/licences.py know of."
    for name in sorted((OTHERS.keys() | CONTAINED.keys()) - found.keys()):
        yield f"{name} is not installed any more: take it out of .ci/licences.py and the README."


if __name__ == "__main__":
    found = licences(sys.argv[1])
    if complaints := list(problems(found)):
        sys.exit("\n".join(complaints))
    contained = "".join(f"\n  {name} contains {what}" for name, what in CONTAINED.items())
    sys.stdout.write(f"The licences of {len(found)} packages are as the README says. Of binary wheels:{contained}\n")
