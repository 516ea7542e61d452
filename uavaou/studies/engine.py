"""What an engine is: it performs a study's jobs somewhere, and tells how they stand."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, Protocol

from uavaou.studies.jobs import Job, Key, Report


@dataclass(frozen=True)
class Advanced:
    """A training has made an update."""

    key: Key
    report: Report


@dataclass(frozen=True)
class Ended:
    """A job has ended: with a result, with the reason why it failed, or with neither where it was asked to stop."""

    key: Key
    result: dict[str, Any] | None
    reason: str = ""


Event = Advanced | Ended
Take = Callable[[], Job | None]  # the next job that can be done now; None: none at present


Events = Generator[Event | None, None, None]


class Engine(Protocol):
    """Performs jobs in processes, on this machine or others."""

    def events(self, take: Take, stopping: Callable[[], bool]) -> Events:
        """Perform what ``take`` gives until it gives nothing and all have ended.

        Args:
            take: asked whenever a process is free.
            stopping: once it says yes, nothing more is taken, and trainings are asked for their last checkpoint.

        Yields:
            What happens, and None now and then while nothing does.

        Raises:
            KeyboardInterrupt: by a second signal; what runs is killed.
        """
        ...
