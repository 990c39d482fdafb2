"""What users can do is documented, and what is documented can be done."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
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
