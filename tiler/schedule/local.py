"""Tasks on worker processes of this machine.

Each worker has one task at a time, so it is known which one killed it, and by what: a worker that crashes, hangs
or is killed for its memory is replaced at once. (Dask's nannies do not know the task, and give up a worker that
dies while it starts, as it does when a task that kills waits for it.)
"""

from __future__ import annotations

import selectors
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace

from tiler.schedule.guard import Died, Guard
from tiler.schedule.task import TRIES, Limits, Outcome, Perform, Task

WORKER_DIED = "WorkerDied"
"""Kind of the error of a task that killed its worker."""


class LocalExecutor:
    """Worker processes, one thread each.

    Parameters
    ----------
    workers : int
    limits : Limits
    """

    def __init__(self, workers: int, limits: Limits | None = None) -> None:
        self.workers = workers
        self._limits = limits or Limits()
        self._guards = [Guard(self._limits.memory_bytes) for _ in range(workers)]

    def run(self, perform: Perform, store_url: str, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Outcomes as they come, one a try; `Outcome.again` tells that another one follows."""
        waiting = iter(tasks)
        again: deque[tuple[Task, int]] = deque()
        with selectors.DefaultSelector() as working:

            def give(guard: Guard) -> None:
                """Let a worker begin with the next task, if there is one."""
                following = again.popleft() if again else next(((task, 1) for task in waiting), None)
                if following is not None:
                    seconds = self._limits.seconds_of(following[0])
                    guard.start(perform, store_url, following[0], seconds=seconds)
                    working.register(guard, selectors.EVENT_READ, (guard, *following))

            for guard in self._guards:
                give(guard)
            while working.get_map():
                for key, _ in working.select():
                    guard, task, number = key.data
                    working.unregister(guard)
                    outcome = _outcome(guard, task, number)
                    if outcome.again:
                        again.append((task, number + 1))
                        guard.close()  # the next try is another process's
                    give(guard)
                    yield outcome

    def close(self) -> None:
        """End the workers, whatever they do."""
        for guard in self._guards:
            guard.close()


def _outcome(guard: Guard, task: Task, number: int) -> Outcome:
    """What became of a try."""
    last = number >= TRIES
    try:
        outcome: Outcome = guard.result()
    except Died as died:
        text = f"killed its worker {number} times: it {died}" if last else f"its worker {died}"
        return Outcome(task, None, text, WORKER_DIED, again=not last)
    except Exception as error:  # noqa: BLE001 - the task did not even reach its worker, or its outcome the way back
        return Outcome(task, None, f"{type(error).__name__}: {error}", type(error).__name__, again=not last)
    return replace(outcome, again=outcome.again and not last)
