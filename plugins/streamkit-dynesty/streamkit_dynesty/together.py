"""A pool for walks that call the likelihood point by point. The calls of all walks are made together."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from streamkit import Array


class Together:
    """``size`` walks run in threads. When all wait for a likelihood, the caller evaluates all of them in one call.

    ``evaluate`` returns ln likelihood (n,) at points (n, d). Only the thread that calls `map` calls it.
    """

    def __init__(self, evaluate: Callable[[Array], Array], size: int) -> None:
        self._evaluate, self._size = evaluate, size
        self._change = threading.Condition()
        self._asked: dict[int, Array] = {}
        self._answers: dict[int, float] = {}
        self._walking = 0
        self._fault: BaseException | None = None

    def ln_likelihood(self, point: Array) -> float:
        """Return ln likelihood at a point (d,): at once outside of a walk."""
        if not threading.current_thread().name.startswith("walk"):
            return float(self._evaluate(point[None])[0])
        me = threading.get_ident()
        with self._change:
            self._asked[me] = np.array(point)
            self._change.notify_all()
            self._change.wait_for(lambda: me in self._answers or self._fault is not None)
            if self._fault is not None:
                raise _End
            return self._answers.pop(me)

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> list[Any]:
        """Return the results of the function for the items, in order. An exception in a thread is raised here."""
        todo = list(enumerate(items))
        results: list[Any] = [None] * len(todo)
        todo.reverse()
        self._fault, self._asked, self._answers = None, {}, {}

        def walk() -> None:
            try:
                while True:
                    with self._change:
                        if not todo or self._fault is not None:
                            break
                        place, item = todo.pop()
                    results[place] = function(item)
            except _End:
                pass
            except BaseException as error:
                self._fault = error
            finally:
                with self._change:
                    self._walking -= 1
                    self._change.notify_all()

        threads = [threading.Thread(target=walk, name=f"walk {i}") for i in range(min(self._size, len(todo)))]
        self._walking = len(threads)
        for thread in threads:
            thread.start()
        try:
            self._serve()
        except BaseException as error:
            self._fault = error
        with self._change:
            self._change.notify_all()
        for thread in threads:
            thread.join()
        if self._fault is not None:
            raise self._fault
        return results

    def _serve(self) -> None:
        """Evaluate the points of the walks until the last has ended, or one has failed."""
        while True:
            with self._change:
                # after a fault the waiting walks end without an answer: the two numbers may never be equal
                self._change.wait_for(lambda: self._fault is not None or len(self._asked) == self._walking)
                if self._fault is not None or not self._walking:
                    return
                asked, self._asked = self._asked, {}
            values = self._evaluate(np.array(list(asked.values())))
            with self._change:
                self._answers.update(zip(asked, values.tolist(), strict=True))
                self._change.notify_all()


class _End(BaseException):
    """Raised in a walk whose call gets no answer."""
