"""Tasks on processes of this machine, a thread of the command for each of them; a task that fails is tried again."""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait

from tiler.schedule.children import Children, Run, judged
from tiler.schedule.task import Limits, Look, Machine, Outcome, Perform, Task


class LocalExecutor:
    """Gives tasks to child processes, one at a time to each.

    Parameters
    ----------
    workers : int
    limits : Limits
    """

    def __init__(self, workers: int, limits: Limits | None = None) -> None:
        self.workers = workers
        self._run = Run(uuid.uuid4().hex, limits or Limits())
        self._children = Children()
        self._threads = ThreadPoolExecutor(workers, thread_name_prefix="worker")

    def on_each_worker(self, look: Look) -> None:
        """Nothing: this machine is the one that would look."""

    def machines(self) -> list[Machine]:
        """No machines of a cluster: tasks run on this one."""
        return []

    def run(self, perform: Perform, store_url: str, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Outcomes as they come, one a try; `Outcome.again` tells that another one follows."""
        waiting = iter(tasks)
        running: dict[Future[Outcome], int] = {}

        def begin(task: Task, number: int) -> None:
            work = self._threads.submit(self._children.perform, self._run, perform, store_url, task)
            running[work] = number

        def fill() -> None:
            while len(running) < self.workers and (task := next(waiting, None)) is not None:
                begin(task, 1)

        fill()
        while running:
            for work in wait(running, return_when=FIRST_COMPLETED).done:
                number = running.pop(work)
                outcome = judged(work.result(), number)
                if outcome.again:
                    begin(outcome.task, number + 1)
                fill()
                yield outcome

    def close(self) -> None:
        """End the processes, whatever they do."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        self._children.end(self._run.token)
        self._threads.shutdown()  # each thread sees its child's end
