"""What a step of the reconstruction raises that nobody foresaw, in words for its user."""

from __future__ import annotations

import pytest

from rholoc.errors import MappingFailed
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.trajectory.child import ReconstructionBroken, run_in_child


def _fail(text: str, _: ProgressListener) -> None:
    raise RuntimeError(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "The reconstruction stopped at an unexpected error: RuntimeError"),
        ("out of range", "The reconstruction stopped at an unexpected error: RuntimeError: out of range"),
        (
            "\nIndeterminant linear system detected while working near variable\n0 (Symbol: d0)",
            "What was measured leaves the shape of the walk open.",
        ),
    ],
)
def test_a_librarys_error_is_reported_in_words(text: str, message: str) -> None:
    with pytest.raises(MappingFailed) as raised:
        run_in_child(_fail, text, progress=silent, stage=Stage.POSES)
    assert raised.value.message == message
    assert raised.value.hint
    assert isinstance(raised.value, ReconstructionBroken) == ("unexpected" in message)
