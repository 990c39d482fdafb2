"""What users can do is documented, and what is documented can be done."""

import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer.main

from rholoc import __version__
from rholoc.cli import app
from rholoc.exports import ExportFormat
from rholoc.features import extractor_names
from rholoc.mapping import BuildOptions
from rholoc.maps import DensityKind
from rholoc.recordings.readers import READERS
from rholoc.reports import AdviceKind, WarningKind
from rholoc.simulation import Light
from rholoc.trajectory import PoseMethod

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / name
    for name in (
        "README.md",
        "CHANGELOG.md",
        "CONTRIBUTING.md",
        "docs/howto.md",
        "docs/robots.md",
        "docs/library.md",
        "docs/method.md",
        "docs/experiments.md",
        "docs/paper.md",
        "docs/others.md",
        "server/README.md",
        "docs/service/asking.md",
        "docs/service/mapping.md",
        "docs/service/operating.md",
        "docs/service/reference.md",
        "server/COMMANDS.md",
        "maps/README.md",
        "ros/README.md",
    )
]
README = (ROOT / "README.md").read_text(encoding="utf-8")
REFERENCE = (ROOT / "server" / "COMMANDS.md").read_text(encoding="utf-8")


def commands(group: Any = None, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command that does something, with its path: ("map", "build")."""
    group = group or typer.main.get_command(app)
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*path, name))
        else:
            yield (*path, name), command


COMMANDS = dict(commands())


def section(path: tuple[str, ...]) -> str:
    """The reference's section on a command."""
    match = re.search(rf"^### `rholoc {' '.join(path)}(?![\w-]).*?(?=^##|\Z)", REFERENCE, re.MULTILINE | re.DOTALL)
    assert match, f"server/COMMANDS.md has no section on rholoc {' '.join(path)}"
    return match[0]


def shell_lines(page: str = README) -> list[str]:
    """A page's shell commands, continued lines joined."""
    blocks = re.findall(r"^```sh\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in block.replace("\\\n", " ").splitlines() if line.strip()]


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_every_option_of_a_command_is_documented(path: tuple[str, ...]) -> None:
    text = section(path)
    for parameter in COMMANDS[path].params:
        if parameter.param_type_name == "option":
            for name in (*parameter.opts, *parameter.secondary_opts):
                if name not in ("--help", "-h"):
                    assert f"`{name}`" in text, f"rholoc {' '.join(path)}: {name} is not documented"


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_no_option_is_documented_that_does_not_exist(path: tuple[str, ...]) -> None:
    known = {name for parameter in COMMANDS[path].params for name in (*parameter.opts, *parameter.secondary_opts)}
    documented = re.findall(r"^\|[^|]*?`(--[a-z-]+)`", section(path), re.MULTILINE)
    assert set(documented) <= known


def test_no_command_is_documented_that_does_not_exist() -> None:
    documented = re.findall(r"^### `rholoc ([a-z -]+)", REFERENCE, re.MULTILINE)
    assert {tuple(name.split()) for name in documented} == set(COMMANDS)


@pytest.mark.parametrize(
    "name", ["README.md", "docs/howto.md", "docs/robots.md", "docs/paper.md", "server/COMMANDS.md"]
)
def test_commands_that_are_shown_parse(name: str) -> None:
    lines = [line for line in shell_lines((ROOT / name).read_text(encoding="utf-8")) if line.startswith("rholoc ")]
    assert lines
    for line in lines:
        words = shlex.split(line, comments=True)[1:]
        path = next(path for path in COMMANDS if tuple(words[: len(path)]) == path)
        COMMANDS[path].make_context("rholoc", words[len(path) :])  # raises where an option or a value is wrong


def test_the_readmes_make_targets_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = [line.split()[1] for line in shell_lines() if line.startswith("make ")]
    assert {"demo", "test", "serve"} <= set(targets)
    for target in targets:
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


def test_the_readmes_python_runs_on_the_client() -> None:
    import rholoc_client

    (code,) = re.findall(r"^```python\n(.*?)^```", README, re.MULTILINE | re.DOTALL)
    compile(code, "README.md", "exec")
    assert set(re.findall(r"\bfrom rholoc_client import (\w+)", code)) <= set(rholoc_client.__all__)
    for method in re.findall(r"\brholoc\.(\w+)\(", code):
        assert hasattr(rholoc_client.Client, method)
    for name in re.findall(r"answer\.pose\.(\w+)", code):
        assert name in rholoc_client.Pose.__dataclass_fields__


def test_defaults_are_documented_as_they_are() -> None:
    text = section(("map", "build"))
    options = BuildOptions()
    for value in (options.features, options.density.value, options.poses.value):
        assert f"`{value}` (default)" in text


@pytest.mark.parametrize(
    ("path", "option", "choices"),
    [
        (("map", "build"), "density", list(DensityKind)),
        (("map", "build"), "poses", list(PoseMethod)),
        (("map", "build"), "features", extractor_names(only_installed=False)),
        (("map", "export"), "to", list(ExportFormat)),
        (("simulate",), "light", list(Light)),
    ],
)
def test_help_names_the_choices_there_are(path: tuple[str, ...], option: str, choices: list[str]) -> None:
    (parameter,) = [one for one in COMMANDS[path].params if one.name == option]
    assert sorted(parameter.metavar.split("|")) == sorted(choices)
    assert all(f"`{one}`" in section(path) for one in choices)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#\s]+)", text):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_files_that_the_readme_uses_are_shipped() -> None:
    for name in re.findall(r"@(maps/[\w./-]+)", README):
        assert (ROOT / name).is_file(), name


def test_the_version_has_an_entry_in_the_changelog() -> None:
    assert f"## {__version__}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


PACKAGE = ROOT / "server" / "rholoc"
METHOD = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


@cache
def sources(folder: Path) -> dict[Path, str]:
    """The text of each module in a folder."""
    return {file: file.read_text(encoding="utf-8") for file in folder.rglob("*.py")}


@pytest.mark.parametrize("module", sorted(set(re.findall(r"`([a-z_0-9]+(?:/[a-z_0-9]+)+\.py)`", METHOD))))
def test_modules_of_the_method_exist(module: str) -> None:
    assert (PACKAGE / module).is_file()


def test_modules_that_the_method_names_without_their_room_exist() -> None:
    named = set(re.findall(r"`([a-z_0-9]+\.py)`", METHOD))
    assert named <= {path.name for path in PACKAGE.rglob("*.py")}


@pytest.mark.parametrize("path", sorted(set(re.findall(r"`((?:server|tests|benchmarks|maps)/[\w/.]*)`", CONTRIBUTING))))
def test_paths_for_contributors_exist(path: str) -> None:
    assert (ROOT / path).exists()


def test_every_package_is_in_the_table_for_contributors() -> None:
    named = set(re.findall(r"`(\w+)`", CONTRIBUTING))
    assert {folder.name for folder in PACKAGE.iterdir() if (folder / "__init__.py").is_file()} <= named


def test_nothing_cites_a_design_that_is_not_here() -> None:
    assert [path for path, text in sources(PACKAGE).items() if "DESIGN" in text] == []


FORMATS = (ROOT / "maps" / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", [*WarningKind, *AdviceKind])
def test_every_warning_and_advice_is_documented(kind: WarningKind | AdviceKind) -> None:
    assert f"`{kind.value}`" in REFERENCE


def test_every_format_has_a_row() -> None:
    section = FORMATS.split("### Formats of recorder apps and datasets")[1].split("\n##")[0]
    rows = [line for line in section.splitlines() if line.startswith("| ")]
    assert len(rows) == 1 + len(READERS)  # the head


OPENING_VIDEOS = {"recordings/frames/live_camera.py", "recordings/frames/video.py"}


@pytest.mark.parametrize(
    ("what", "pattern", "homes"),
    [
        ("angles between rotations", r"\.magnitude\(\)|\btrace\(.*- 1", {"geometry/vectors.py"}),
        ("alignments of points", r"align_vectors|def (kabsch|umeyama|align_poses)", {"geometry/alignment.py"}),
        ("cameras as text and JSON", r"\*distortion = |asdict\([\w.]*camera\)", {"geometry/camera.py"}),
        ("visual words", r"\bKmeans\b", {"features/picture_vectors.py"}),
        ("a full disk's errors", r"\bENOSPC\b|\bEDQUOT\b", {"disk.py"}),
        ("VTK's PolyData", r'VTKFile type="PolyData"', {"maps/formats/ply_and_vtp.py"}),
        (
            "starting and killing processes",
            r"\bPopen\(|\bget_context\(|create_subprocess_|\bos\.(kill|killpg|fork)\(|subprocess\.run\(|psutil\.Process\(",
            {"processes/async_program.py", "processes/child.py", "processes/program.py", "processes/tree.py"},
        ),
        ("opening videos and cameras", r"\bcv2\.VideoCapture\(", OPENING_VIDEOS),
    ],
)
def test_it_has_one_home(what: str, pattern: str, homes: set[str]) -> None:
    found = {str(file.relative_to(PACKAGE)) for file, text in sources(PACKAGE).items() if re.search(pattern, text)}
    assert found == homes, what


@pytest.mark.parametrize("folder", ["server", "client", "tests", "benchmarks"])
def test_no_angle_is_the_arccos_of_a_rounded_cosine(folder: str) -> None:
    """It is NaN just above 1 and off by 1e-8 rad just below it; :mod:`rholoc.geometry.vectors` uses atan2."""
    found = {file for file, text in sources(ROOT / folder).items() if re.search(r"\ba(rc)?cos\(", text)}
    assert found <= {Path(__file__)}
