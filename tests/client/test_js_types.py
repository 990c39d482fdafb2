"""The declarations of @rholoc/client: they are those of the service's OpenAPI document, and TypeScript takes them."""

import runpy
import subprocess
from pathlib import Path

import pytest

CLIENT = Path(__file__).parents[2] / "client"
TSC = CLIENT / "node_modules" / ".bin" / "tsc"
PROGRAM = """
import { Axes, Client, MapSession, RholocError } from "@rholoc/client";
const rholoc = new Client("https://rholoc.example");
const answer = await rholoc.localize("hall", new Blob([]), { dof: 6, camera: { fx: 500, distortion: [0.1] } });
const near: string[] = answer.near;
const position: number[] | undefined = answer.pose?.position;
const cause: "blur" | string | undefined = answer.diagnosis?.cause;
const kind: string | undefined = (await rholoc.map("hall")).names.points?.[0]?.kind;
const session = new MapSession((image, options) => rholoc.localize("hall", image, options), {
  axes: Axes.UNITY,
  onLocalized: (T) => T[0][3].toFixed(2),
});
const drawn: number[] | null = session.toSession([1, 2, 3]);
const failed = (error: RholocError) => error.passes;
export { near, position, cause, kind, drawn, failed };
"""
WRONG = {
    'rholoc.localize("hall", new Blob([]), { camra: {} });': "camra",
    "const x: string = answer.confidence;": "'number' is not assignable",
    "answer.pose.position;": "possibly 'null'",
}

pytestmark = pytest.mark.skipif(not TSC.is_file(), reason="make client/node_modules/.installed")


def test_declarations_are_written_from_the_openapi_document(openapi):
    """After a change: make format."""
    script = runpy.run_path(str(CLIENT / "js" / "write_types.py"))
    written = script["written_types"](openapi["components"]["schemas"])
    assert {path.name: path.read_text(encoding="utf-8") for path in script["TYPES"].iterdir()} == written


@pytest.mark.slow
def test_a_program_in_typescript_is_checked_by_them(tmp_path):
    said = checked(tmp_path, PROGRAM + "\n".join(WRONG)).splitlines()
    assert len(said) == len(WRONG)
    for line, words in zip(said, WRONG.values(), strict=True):
        assert words in line


def checked(folder: Path, program: str) -> str:
    """What tsc says of a program."""
    installed = folder / "node_modules" / "@rholoc" / "client"
    if not installed.exists():
        installed.parent.mkdir(parents=True)
        installed.symlink_to(CLIENT / "js")
    (folder / "program.ts").write_text(program)
    target = ["--target", "es2022", "--module", "esnext", "--moduleResolution", "bundler", "--lib", "es2022,dom"]
    command = [str(TSC), "--noEmit", "--strict", "--skipDefaultLibCheck", *target, "program.ts"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False).stdout
