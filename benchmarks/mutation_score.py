"""How many small faults the tests notice: mutants of some modules, drawn by a seed, each run against tests.

    python benchmarks/mutation_score.py density localization trajectory service/access/guard --mutants 160

Each mutant differs from a module in one place: a comparison, an arithmetic or logical operator, a number, a condition,
or min for max. First the fast tests of a package run once, and which functions each of them calls is recorded. Then a
process is forked for each mutant in which the module is compiled from the mutant's syntax tree (no file is touched).
The tests that call the changed function run, shortest first, until one fails. A mutant on which all pass has survived;
one that exceeds its time counts as noticed, as it would be. Mutants that no test could notice are listed, each with its
reason, in ``equivalent_mutants.toml``, and are not drawn. The share of those drawn is an estimate of the share of all:
40 of a package tell it to 6 percentage points (one standard deviation at 85 %).
"""

from __future__ import annotations

import argparse
import ast
import copy
import importlib.abc
import importlib.util
import json
import os
import pickle
import random
import signal
import sys
import tempfile
import threading
import time
import tomllib
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "server" / "rholoc"
EQUIVALENT = Path(__file__).with_name("equivalent_mutants.toml")
TESTS = {
    "density": ["tests/density/", "tests/mapping/test_tensor_fit.py", "tests/localization/test_tensor_ascent.py"],
    "localization": ["tests/localization/"],
    "trajectory": ["tests/trajectory/"],
    "service": ["tests/service/test_guard.py", "tests/service/test_access.py", "tests/service/test_streams.py"],
}
THIRD_PARTY = (
    "numpy", "scipy.spatial.transform", "scipy.stats", "cv2", "faiss", "poselib", "gtsam", "pycolmap", "fastapi",
    "httpx",
)  # fmt: skip
THIRD_PARTY_OF_TESTS = ("pytest", "_pytest.config", "hypothesis", "uvicorn", "pydantic_settings", "safetensors.numpy")

_COMPARISONS = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.Pow: ast.Mult,
}  # fmt: skip
_NAMES = {
    "min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "argmin": "argmax", "argmax": "argmin",
    "any": "all", "all": "any", "sin": "cos", "cos": "sin",
}  # fmt: skip
_WITHOUT_EFFECT = {"strict", "optimize"}  # arguments: zip's, which asserts, and einsum's, which orders the sums


@dataclass(frozen=True)
class Mutant:
    """One change: the ``number``-th node of a module's tree, in the order of ``_walk_code``.

    ``function`` is the first line of the innermost function around it; None where there is none or it caches.
    """

    module: Path
    number: int
    line: int
    source: str
    change: str
    function: int | None

    @property
    def key(self) -> tuple[str, str, str]:
        """What names it also when lines have moved."""
        return str(self.module.relative_to(PACKAGE)), self.source, self.change

    @property
    def name(self) -> str:
        """The module's, with dots."""
        return ".".join(("rholoc", *self.module.relative_to(PACKAGE).with_suffix("").parts))


def _mutated(node: ast.AST) -> tuple[ast.AST, str] | None:
    """A changed copy of a node, and what was changed; None where nothing of it is to be changed."""
    new = copy.copy(node)
    match node:
        case ast.Compare(ops=[op]) if type(op) in _COMPARISONS:
            new.ops = [_COMPARISONS[type(op)]()]
        case ast.BinOp(op=op, left=left, right=right) if type(op) in _OPERATORS and not _text(left) | _text(right):
            new.op = _OPERATORS[type(op)]()
        case ast.BoolOp():
            new.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        case ast.UnaryOp(op=ast.Not()):
            new = node.operand
        case ast.UnaryOp(op=ast.USub()) if not isinstance(node.operand, ast.Constant):
            new = node.operand
        case ast.IfExp():
            new.body, new.orelse = node.orelse, node.body
        case ast.Constant(value=bool(value)):
            new.value = not value
        case ast.Constant(value=int(value) | float(value)):
            new.value = 1 if value == 0 else value * 8 if isinstance(value, float) else value + 1
        case ast.Attribute(attr=name) if name in _NAMES:
            new.attr = _NAMES[name]
        case ast.Name(id=name) if name in _NAMES:
            new.id = _NAMES[name]
        case _:
            return None
    return new, f"{ast.unparse(node)} -> {ast.unparse(new)}"


def _text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _walk_code(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes but those of annotations, which do not run, of decorators and of ``_WITHOUT_EFFECT``."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for node in value if isinstance(value, list) else [value]:
            if isinstance(node, ast.AST) and not (isinstance(node, ast.keyword) and node.arg in _WITHOUT_EFFECT):
                yield node
                yield from _walk_code(node)


def mutants_of(module: Path) -> list[Mutant]:
    """All there are."""
    text = module.read_text(encoding="utf-8")
    lines, tree = text.splitlines(), ast.parse(text)
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    found = []
    for number, node in enumerate(_walk_code(tree)):
        if isinstance(node, ast.expr) and (mutated := _mutated(node)) is not None:
            around = [f for f in functions if f.body[0].lineno <= node.lineno <= (f.end_lineno or 0)]
            change = mutated[1].replace("\n", " ")
            first_line = _first_line(around[-1]) if around else None  # the walk is breadth first
            found.append(Mutant(module, number, node.lineno, lines[node.lineno - 1].strip(), change, first_line))
    return found


def _first_line(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int | None:
    if any("cache" in ast.unparse(decorator) for decorator in function.decorator_list):
        return None
    return min([function.lineno, *(decorator.lineno for decorator in function.decorator_list)])


def _compiled(mutant: Mutant) -> object:
    tree = ast.parse(mutant.module.read_text(encoding="utf-8"))
    target = list(_walk_code(tree))[mutant.number]
    mutated = _mutated(target)
    assert mutated is not None

    class Replace(ast.NodeTransformer):
        def visit(self, node: ast.AST) -> ast.AST:
            return ast.copy_location(mutated[0], node) if node is target else self.generic_visit(node)

    return compile(ast.fix_missing_locations(Replace().visit(tree)), str(mutant.module), "exec")


class _MutantFinder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports one module from a mutant."""

    def __init__(self, mutant: Mutant) -> None:
        self._mutant = mutant

    def find_spec(self, fullname: str, path: object, target: object = None) -> object:
        if fullname != self._mutant.name:
            return None
        return importlib.util.spec_from_loader(fullname, self, origin=str(self._mutant.module))

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = str(self._mutant.module)
        exec(_compiled(self._mutant), module.__dict__)  # type: ignore[call-overload]


@dataclass(eq=False)
class Calls:
    """Which functions, by file and first line, each test calls, itself or by its fixtures, and what it takes.

    A plugin of pytest. Lambdas and comprehensions count as the function around them.
    """

    calls: dict[str, set[tuple[str, int]]] = field(default_factory=lambda: defaultdict(set))
    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    fixtures: dict[str, list[str]] = field(default_factory=dict)
    _now: str = ""

    def _trace(self, frame: FrameType, event: str, argument: object) -> None:
        if frame.f_code.co_filename.startswith(str(PACKAGE)):
            self.calls[self._now].add((frame.f_code.co_filename, frame.f_code.co_firstlineno))

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        """From here on."""
        self.fixtures = {item.nodeid: item.fixturenames for item in items}
        threading.settrace(self._trace)  # type: ignore[arg-type]
        sys.settrace(self._trace)  # type: ignore[arg-type]

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Calls are of this test now."""
        self._now = nodeid

    def pytest_runtest_logreport(self, report: Any) -> None:
        """What it took."""
        self.seconds[report.nodeid] += report.duration

    def of_fixtures(self) -> Any:
        """Another plugin, that sees fixtures set up: what those of many tests call is called by each of them."""
        import pytest

        calls = self

        class Fixtures:
            @pytest.hookimpl(wrapper=True)
            def pytest_fixture_setup(self, fixturedef: Any) -> Any:
                before = calls._now
                if fixturedef.scope != "function":
                    calls._now = f"fixture {fixturedef.argname}"
                try:
                    return (yield)
                finally:
                    calls._now = before

        return Fixtures()

    def tests_of(self, mutant: Mutant) -> list[str]:
        """The tests that call the innermost function around a mutant, the shortest first.

        Where there is none, as of what runs when a module is imported, those that call any function of the module.
        """
        called = {
            test: self.calls[test].union(*(self.calls[f"fixture {name}"] for name in names))
            for test, names in self.fixtures.items()
        }
        direct = [test for test, calls in called.items() if (str(mutant.module), mutant.function) in calls]
        near = [test for test, calls in called.items() if any(file == str(mutant.module) for file, _ in calls)]
        return sorted(direct or near, key=lambda test: self.seconds[test])


def _forked(run: Callable[[], int], cpu_s: float = 0.0) -> int:
    """The exit code of what runs in a process of its own, which a signal ends after ``cpu_s``; 0 is without end."""
    child = os.fork()
    if child == 0:
        os.setsid()
        signal.setitimer(signal.ITIMER_PROF, cpu_s)
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        status = 1
        try:
            status = run()
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _run_tests(tests: Sequence[str], limit_s: int, plugins: Sequence[object] = ()) -> int:
    import pytest

    options = ["-x", "-q", "--tb=no", "-p", "no:cacheprovider", "-p", "no:xdist", "-m", "not slow and not real"]
    options.append(f"--timeout={limit_s}")
    return int(pytest.main([*options, *tests], plugins=list(plugins)))


def calls_of(tests: list[str], limit_s: int) -> Calls | None:
    """What tests call, in the code as it is; None where one fails."""
    with tempfile.NamedTemporaryFile() as file:

        def run() -> int:
            calls = Calls()
            status = _run_tests(tests, limit_s, [calls, calls.of_fixtures()])
            Path(file.name).write_bytes(pickle.dumps((dict(calls.calls), dict(calls.seconds), calls.fixtures)))
            return status

        if _forked(run) != 0:
            return None
        called, seconds, fixtures = pickle.loads(Path(file.name).read_bytes())
    return Calls(defaultdict(set, called), defaultdict(float, seconds), fixtures)


def is_noticed(mutant: Mutant, calls: Calls, limit_s: int) -> bool:
    """Whether some test fails on a mutant."""
    tests = calls.tests_of(mutant)

    def run() -> int:
        sys.meta_path.insert(0, _MutantFinder(mutant))
        return _run_tests(tests, limit_s)

    return bool(tests) and _forked(run, 20 + 5 * sum(calls.seconds[test] for test in tests)) != 0


def equivalent_mutants() -> set[tuple[str, str, str]]:
    """The keys of those that were reviewed and found to behave like the original."""
    table = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8"))
    return {(entry["module"], entry["source"], entry["change"]) for entry in table["mutant"]}


def main() -> None:
    """Draw mutants, try each, print the survivors and the share that was noticed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="+", help="packages or modules of rholoc: density, service/access/guard")
    parser.add_argument("--mutants", type=int, default=160, help="how many in all, shared evenly by the packages")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=int, default=120, help="seconds that a test may take on a mutant")
    chosen = parser.parse_args()
    os.chdir(ROOT)
    sys.path[:0] = [str(ROOT / "server"), str(ROOT / "client")]
    for name in (*THIRD_PARTY, *THIRD_PARTY_OF_TESTS):
        importlib.import_module(name)

    by_package: dict[str, list[Mutant]] = defaultdict(list)
    for part in chosen.parts:
        at = PACKAGE / part
        for module in sorted(at.rglob("*.py")) if at.is_dir() else [at.with_suffix(".py")]:
            by_package[part.split("/")[0]] += mutants_of(module)
    equivalent = equivalent_mutants()
    for package, every in by_package.items():
        began = time.monotonic()
        calls = calls_of(TESTS[package], 10 * chosen.limit)
        if calls is None:
            sys.exit(f"The tests of {package} fail on the code as it is: {' '.join(TESTS[package])}")
        print(f"{package}: {len(calls.fixtures)} tests in {time.monotonic() - began:.0f} s", flush=True)
        distinct = [mutant for mutant in every if mutant.key not in equivalent]
        drawn = random.Random(chosen.seed).sample(distinct, min(len(distinct), chosen.mutants // len(by_package)))
        survivors = []
        for mutant in drawn:
            began = time.monotonic()
            noticed = is_noticed(mutant, calls, chosen.limit)
            where = f"{mutant.module.relative_to(PACKAGE)}:{mutant.line}"
            took = f"{time.monotonic() - began:4.0f} s"
            print(f"{'noticed ' if noticed else 'SURVIVED'} {took}  {where}  {mutant.change}", flush=True)
            if not noticed:
                survivors.append(mutant)
        for mutant in survivors:
            module, source, change = map(json.dumps, mutant.key)
            print(f"[[mutant]]\nmodule = {module}\nsource = {source}\nchange = {change}\n")
        print(
            f"{package}: {len(drawn) - len(survivors)} of {len(drawn)} mutants noticed, "
            f"{1 - len(survivors) / max(len(drawn), 1):.0%}; there are {len(distinct)}, "
            f"and {len(every) - len(distinct)} that no test could notice",
            flush=True,
        )


if __name__ == "__main__":
    main()
