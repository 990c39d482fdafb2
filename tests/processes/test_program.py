"""Programs beside this one."""

import asyncio
import os
import signal
import subprocess
import threading
from pathlib import Path

import pytest

from rholoc.processes.async_program import AsyncProgram
from rholoc.processes.interrupts import interrupts_deferred
from rholoc.processes.program import Program, running_program
from rholoc.processes.tree import descendants
from waiting import alive, until

_PROGRAM = "slow_program"


@pytest.fixture(autouse=True)
def _found(monkeypatch: pytest.MonkeyPatch) -> None:
    path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    monkeypatch.setenv("PYTHONPATH", path)


def _started_by(program: Program) -> int:
    """The process that the program started."""
    return int(program._process.stdout.readline())


@pytest.mark.parametrize("arguments", [("idle",), ("deaf",)])
def test_a_stopped_program_leaves_nothing_behind(arguments: tuple[str, ...]) -> None:
    with running_program(_PROGRAM, *arguments, grace_s=0.5, stdout=subprocess.PIPE) as program:
        other = _started_by(program)
        assert program.running
        assert other in descendants(program.pid)
    assert not program.running
    until(lambda: not alive(other))


def test_the_end_of_its_input_asks_a_program_to_end() -> None:
    program = Program(_PROGRAM, first_input=b'{"a": 1}\n', stdout=subprocess.PIPE)
    other = _started_by(program)
    program.stop(grace_s=60.0)
    assert program._process.returncode == 0
    until(lambda: not alive(other))


def test_an_interrupt_waits_while_a_process_starts() -> None:
    reached = False

    def interrupt() -> None:
        nonlocal reached
        with interrupts_deferred():
            signal.raise_signal(signal.SIGINT)
            reached = True

    ignored = signal.signal(signal.SIGINT, signal.default_int_handler)  # where whoever started the tests had it so
    try:
        with pytest.raises(KeyboardInterrupt):
            interrupt()
    finally:
        signal.signal(signal.SIGINT, ignored)
    assert reached


def test_threads_are_never_interrupted() -> None:
    entered = threading.Event()

    def enter() -> None:
        with interrupts_deferred():
            entered.set()

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert entered.is_set()


def test_a_program_answers_an_event_loop() -> None:
    async def talk() -> tuple[bytes, bytes, int]:
        program = await AsyncProgram.start(_PROGRAM)
        other = int(await program.read_line(60.0))
        await program.ask({"a": 1})
        answer = await program.read_line(60.0)
        reading = asyncio.create_task(program.read(100, 60.0))
        await asyncio.sleep(0)
        await program.kill()
        assert not program.running
        return answer, await reading, other

    answer, rest, other = asyncio.run(talk())
    assert (answer, rest) == (b'{"a": 1}\n', b"")
    os.kill(other, signal.SIGKILL)


def test_a_program_that_does_not_answer_in_time() -> None:
    async def wait() -> None:
        program = await AsyncProgram.start(_PROGRAM)
        other = int(await program.read_line(60.0))
        try:
            with pytest.raises(TimeoutError):
                await program.read(100, 0.01)
        finally:
            await program.kill()
            os.kill(other, signal.SIGKILL)

    asyncio.run(wait())
