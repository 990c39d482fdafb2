"""How many small faults the tests notice: mutants of some modules, made and run by mutmut, drawn by a seed.

    pip install mutmut
    python benchmarks/mutation_score.py density localization trajectory service/access/guard --mutants 40

mutmut records once which tests call which function, and then runs only those on a mutant, in a copy of the sources. The
share of the drawn mutants that some test notices is an estimate of the share of all: 40 tell it to 6 percentage points
(one standard deviation at 85 %). Some survivors no test could notice (an einsum's order, a message); they count.
"""

import argparse
import importlib.util
import json
import random
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
TESTS = {
    "density": ("density", "mapping/test_tensor_fit.py", "localization/test_tensor_ascent.py"),
    "localization": ("localization",),
    "trajectory": ("trajectory",),
    "service": tuple(f"service/test_{name}.py" for name in ("guard", "streams", "pacing", "audit", "revocation")),
}
NEVER_MUTATED = ("raise ", "einsum", "strict=")
VERDICT = re.compile(r"^(?P<sign>\S+) (?P<name>rholoc\.\S+__mutmut_\d+)$", re.MULTILINE)
SURVIVED, UNTESTED = "🙁", "🫥"


def prepare(folder: Path, part: str) -> None:
    """Copy what mutmut needs: sources whose package lies at the top, tests, and which of both."""
    shutil.copytree(ROOT / "server" / "rholoc", folder / "rholoc")
    shutil.copytree(ROOT / "tests", folder / "tests")
    for shown in ("client", "maps"):  # the page and the maps that ship with the project
        (folder / shown).symlink_to(ROOT / shown)
    options = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pytest"]["ini_options"]
    lines = ["[pytest]", f"addopts = {options['addopts']}", "markers =", *(f"    {one}" for one in options["markers"])]
    (folder / "pytest.ini").write_text("\n".join(lines) + "\n", encoding="utf-8")
    of_part = f"rholoc/{part}/*" if (folder / "rholoc" / part).is_dir() else f"rholoc/{part}.py"
    lists = {
        "source_paths": ["rholoc"],
        "also_copy": ["maps"],
        "only_mutate": [of_part],
        "do_not_mutate_patterns": NEVER_MUTATED,
        "pytest_add_cli_args_test_selection": [f"tests/{test}" for test in TESTS[part.split("/")[0]]],
        "pytest_add_cli_args": ["-m", "not slow and not real", "-p", "no:xdist", "-p", "no:cacheprovider"],
    }
    config = ["[mutmut]"]
    for name, values in lists.items():
        config += [f"{name} =", *(f"    {value}" for value in values)]
    (folder / "setup.cfg").write_text("\n".join(config) + "\n", encoding="utf-8")


def mutmut(folder: Path, *arguments: str) -> str:
    """What mutmut prints."""
    command = [sys.executable, "-m", "mutmut", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False).stdout


def drawn(folder: Path, count: int, seed: int) -> Sequence[str]:
    """Names of some of the mutants, which mutmut makes when it is asked to run one that does not exist."""
    said = mutmut(folder, "run", "--max-children", "1", "none*")
    names = [name for file in sorted(folder.glob("mutants/**/*.meta")) for name in _names(file)]
    if not names or not (folder / "mutants" / "mutmut-stats.json").is_file():
        sys.exit(f"mutmut made no mutants, or the tests fail on the code as it is:\n{said}")
    return random.Random(seed).sample(names, min(count, len(names)))


def _names(file: Path) -> list[str]:
    return list(json.loads(file.read_text(encoding="utf-8"))["exit_code_by_key"])


def main() -> None:
    """Draw mutants of each part, try them, print the survivors and the share that was noticed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="+", help="packages or modules of rholoc: density, service/access/guard")
    parser.add_argument("--mutants", type=int, default=40, help="how many of each part")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    if importlib.util.find_spec("mutmut") is None:
        parser.error("mutmut is not installed: pip install mutmut")
    for part in chosen.parts:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            prepare(folder, part)
            names = drawn(folder, chosen.mutants, chosen.seed)
            said = mutmut(folder, "run", "--max-children", "1", *names)
            signs = {found["name"]: found["sign"] for found in VERDICT.finditer(said)}
            survivors = [one for one in names if signs.get(one, UNTESTED) in (SURVIVED, UNTESTED)]
            for survivor in survivors:
                print(mutmut(folder, "show", survivor))
            print(f"{part}: {len(names) - len(survivors)} of {len(names)} mutants noticed", flush=True)


if __name__ == "__main__":
    main()
