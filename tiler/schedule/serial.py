"""Tasks one after another in this process."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from tiler.schedule.task import Outcome, Perform, Task


class SerialExecutor:
    """No worker but this process; the obvious reference for the others."""

    workers = 1

    def run(self, perform: Perform, store_url: str, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Outcomes in the order of the tasks."""
        for task in tasks:
            yield perform(store_url, task)

    def close(self) -> None:
        """Nothing to release."""
