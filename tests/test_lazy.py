import threading

from rholoc.lazy import lazy


class Slow:
    def __init__(self, go_on: threading.Event) -> None:
        self._go_on = go_on
        self.computed = 0

    @lazy
    def value(self) -> int:
        """A value."""
        self._go_on.wait(10)
        self.computed += 1
        return self.computed


def test_a_value_is_computed_once():
    go_on = threading.Event()
    go_on.set()
    slow = Slow(go_on)
    assert [slow.value, slow.value, slow.computed] == [1, 1, 1]
    assert Slow.value.__doc__ == "A value."


def test_objects_do_not_wait_for_each_other():
    held, free = threading.Event(), threading.Event()
    free.set()
    waiting = threading.Thread(target=lambda: Slow(held).value)
    waiting.start()
    assert Slow(free).value == 1
    assert waiting.is_alive()
    held.set()
    waiting.join(10)
