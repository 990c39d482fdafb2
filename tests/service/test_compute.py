"""Compute threads are shared fairly: by time on a core, whoever sends how much."""

import asyncio
import os
import sys
import threading
import time
from collections import Counter

import pytest

from rholoc.errors import Busy
from rholoc.service.caller import CLIENT
from rholoc.service.threads import compute
from rholoc.service.threads.compute import ComputePool, Effort
from rholoc.service.threads.niceness import make_thread_nice


def work_for(seconds: float):
    """Work of so many seconds on a core."""

    def work() -> None:
        until_s = time.thread_time() + seconds
        while time.thread_time() < until_s:
            pause_s = time.thread_time() + 0.001
            while time.thread_time() < pause_s:
                pass
            time.sleep(0)  # as code that leaves the interpreter to others does; on a busy machine also its core

    return work


@pytest.fixture(autouse=True)
def _priority_of_others(monkeypatch):
    """Large work of a low priority hardly advances beside other tests."""
    monkeypatch.setattr(compute, "_NICENESS", 0)


async def ask(pool: ComputePool, client: str, seconds: float, effort: Effort = Effort.ORDINARY) -> float:
    """How long a call took, with its wait."""
    CLIENT.set(client)
    begun_s = time.perf_counter()
    await pool.run(work_for(seconds), effort)
    return time.perf_counter() - begun_s


async def keep_asking(pool: ComputePool, client: str, seconds: float, answered: Counter[str]) -> None:
    while True:
        await ask(pool, client, seconds)
        answered[client] += 1


def test_clients_whose_frames_cost_much_do_not_hold_up_those_whose_cost_little(monkeypatch):
    monkeypatch.setattr(compute, "_ACTIVE_S", 600.0)  # however busy this machine is
    monkeypatch.setattr(compute, "_COSTLY_S", 0.08)

    async def main() -> int:
        pool, answered = ComputePool(2, 16), Counter[str]()
        await ask(pool, "honest", 0.003)
        others = [asyncio.create_task(keep_asking(pool, f"stranger {i}", 0.1, answered)) for i in range(4)]
        while len(answered) < len(others) or min(answered.values()) < 2:  # then it is known what each of them costs
            await ask(pool, "honest", 0.003)
            await asyncio.sleep(0.007)
        before = answered.total()
        for _ in range(12):
            await ask(pool, "honest", 0.003)
            await asyncio.sleep(0.007)
        during = answered.total() - before
        for other in others:
            other.cancel()
        await asyncio.gather(*others, return_exceptions=True)
        pool.close()
        return during

    assert asyncio.run(main()) < 6  # of 12 that would have been waited for


def test_clients_whose_frames_are_all_refused_leave_a_thread_to_those_who_are_localized(monkeypatch):
    monkeypatch.setattr(compute, "_ACTIVE_S", 600.0)

    async def main() -> None:
        pool, end = ComputePool(2, 16), threading.Event()
        strangers = [f"stranger {i}" for i in range(4)]
        await ask(pool, "honest", 0.02)
        for name in strangers:
            CLIENT.set(name)
            await pool.run(work_for(0.02), is_useful=lambda _: False)
        waiting = []
        for name in strangers:
            CLIENT.set(name)
            waiting.append(asyncio.create_task(pool.run(end.wait, is_useful=lambda _: False)))
        await asyncio.sleep(0)  # now they have all asked
        try:
            async with asyncio.timeout(10):
                await ask(pool, "honest", 0.02)
        finally:
            end.set()
            await asyncio.gather(*waiting)
            pool.close()

    asyncio.run(main())


def test_a_client_with_many_calls_waits_for_its_own():
    async def main() -> list[str]:
        pool, order = ComputePool(1, 16), []

        async def noted(client: str) -> None:
            await ask(pool, client, 0.02)
            order.append(client)

        greedy = [asyncio.create_task(noted("greedy")) for _ in range(8)]
        await asyncio.sleep(0.01)
        modest = [asyncio.create_task(noted("modest")) for _ in range(2)]
        await asyncio.gather(*greedy, *modest)
        pool.close()
        return order

    assert "modest" in asyncio.run(main())[:3]


def test_a_full_queue_has_room_for_a_client_that_has_less_in_it():
    async def main() -> None:
        pool = ComputePool(1, 4)
        greedy = [asyncio.create_task(ask(pool, "greedy", 0.05)) for _ in range(5)]
        await asyncio.sleep(0)
        CLIENT.set("greedy")
        with pytest.raises(Busy):
            pool.check_room(Effort.ORDINARY)
        await ask(pool, "modest", 0.01)
        ended = await asyncio.gather(*greedy, return_exceptions=True)
        assert sum(isinstance(one, Busy) for one in ended) == 1
        assert pool.taken == 0
        pool.close()

    asyncio.run(main())


def test_a_pool_that_ends_does_not_wait_for_another_ones_work():
    async def main() -> float:
        busy, idle = ComputePool(2, 16), ComputePool(2, 16)
        working = asyncio.create_task(busy.run(lambda: time.sleep(2)))
        await ask(idle, "anyone", 0.001)
        begun_s = time.perf_counter()
        idle.close()
        took_s = time.perf_counter() - begun_s
        await working
        busy.close()
        return took_s

    assert asyncio.run(main()) < 1


@pytest.mark.skipif(sys.platform != "linux", reason="threads have no priorities of their own")
def test_what_is_nicer_already_stays_so():
    """Without root's rights a service that ran by ``nice`` could not raise its threads' priority, and lost them."""
    found = []

    def work() -> None:
        for niceness in (7, 5):
            make_thread_nice(niceness)
            found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [max(7, os.getpriority(os.PRIO_PROCESS, 0))] * 2


def test_a_lone_client_has_all_threads_whatever_its_frames_cost(monkeypatch):
    monkeypatch.setattr(compute, "_COSTLY_S", 0.08)

    async def main() -> float:
        pool = ComputePool(2, 16)
        for _ in range(2):
            await ask(pool, "alone", 0.1)
        begun_s = time.perf_counter()
        await asyncio.gather(*(pool.run(lambda: time.sleep(0.5)) for _ in range(2)))
        pool.close()
        return time.perf_counter() - begun_s

    assert asyncio.run(main()) < 0.95


def test_a_cancelled_call_leaves_the_queue_and_an_error_comes_through():
    async def main() -> None:
        pool = ComputePool(1, 4)
        running = asyncio.create_task(ask(pool, "a", 0.1))
        waiting = asyncio.create_task(ask(pool, "b", 0.1))
        await asyncio.sleep(0.02)
        assert pool.taken == 2
        waiting.cancel()
        await asyncio.gather(waiting, return_exceptions=True)
        assert pool.taken == 1
        await running

        def fail() -> None:
            raise ValueError("as it is")

        with pytest.raises(ValueError, match="as it is"):
            await pool.run(fail)
        pool.close()

    asyncio.run(main())
