"""The jobs of a study on a Ray cluster, one CPU each, their checkpoints sent back as they are written.

A training works in a folder of its own on whichever machine it is, and no file system is shared: a keeper beside the
study's own process writes what workers send into the run folders, and holds their locks. Where a worker dies, Ray
starts its job again elsewhere, from the last checkpoint that was sent.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

from uavaou.errors import InputError
from uavaou.files import refuse_links, replacing
from uavaou.runs.folder import RunFolder
from uavaou.runs.lock import one_writer
from uavaou.studies.jobs import Advanced, Ended, Event, Events, Job, TakeJob, Training, TrainingReport
from uavaou.studies.parts import PartKey
from uavaou.studies.processes import outcome, prepare

try:
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy
except ModuleNotFoundError as error:
    raise InputError(f"--engine ray: '{error.name}' is not installed: pip install 'uavaou[ray]'") from None

_LOOK_EVERY_S = 0.5
_TELL_EVERY_S = 1.0
Files = dict[str, bytes]  # path below the run folder -> content


class Cluster:
    """Performs jobs as tasks of a Ray cluster.

    Args:
        jobs: tasks at a time; None: as many as the cluster has CPUs.
        address: of a cluster that this machine belongs to, such as ``auto``; None starts one here, for as long as the
            engine is entered.
        plugins: what registers algorithms that are not this package's; a file must be there on every machine.

    Raises:
        InputError: the cluster cannot be reached.
    """

    def __init__(self, jobs: int | None, address: str | None = None, plugins: Sequence[str] = ()) -> None:
        if address is not None and address.startswith("ray://"):
            raise InputError("--address ray://...: run the command on a machine of the cluster, with --address auto")
        self._jobs = jobs
        self._address = address
        self._begun: set[PartKey] = set()  # trainings that have reported
        self._given_up: set[Any] = set()  # cancelled tasks
        self._plugins = [str(Path(place).resolve()) if place.endswith(".py") else place for place in plugins]

    def __enter__(self) -> Self:
        local: dict[str, Any] = {"num_cpus": self._jobs, "include_dashboard": False} if self._address is None else {}
        try:
            with _as_workers_need_it():
                ray.init(address=self._address, log_to_driver=False, logging_level="ERROR", **local)
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise InputError(f"--address {self._address}: no Ray cluster can be reached: {str(error)[:200]}") from error
        here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
        self._keeper = ray.remote(Keeper).options(num_cpus=0, scheduling_strategy=here, max_concurrency=1).remote()
        return self

    def __exit__(self, *_: object) -> None:
        ray.shutdown()

    def events(self, take: TakeJob, stopping: Callable[[], bool]) -> Events:
        """See :class:`~uavaou.studies.jobs.Engine`."""
        running: dict[Any, Job] = {}
        # A worker that is killed is no failure of the job: it is done again, without end.
        perform = ray.remote(num_cpus=1, max_retries=-1, max_calls=1)(_perform)
        asked = False
        try:
            while True:
                if stopping() and not asked:
                    asked = True
                    yield from self._news()
                    self._stop(running)
                while not asked and len(running) < self._room() and (job := take()) is not None:
                    problem = self._open(job)
                    if problem is not None:
                        yield problem
                        continue
                    running[perform.remote(job_sent(job), self._keeper, self._plugins)] = job
                if not running:
                    return
                done, _ = ray.wait(list(running), timeout=_LOOK_EVERY_S)
                yield from self._news()
                for reference in done:
                    yield self._ended(reference, running.pop(reference))
                yield None
        finally:
            for reference in running:
                ray.cancel(reference, force=True)

    def _room(self) -> int:
        present = int(ray.cluster_resources().get("CPU", 0))
        return max(present if self._jobs is None else min(self._jobs, present), 1)

    def _stop(self, running: dict[Any, Job]) -> None:
        """Ask trainings for their last checkpoint; what else runs, and what waits for a CPU, is given up."""
        ray.get(self._keeper.stop.remote())
        for reference, job in running.items():
            # A training that has not reported has nothing to save, and may wait for a CPU without end.
            if not isinstance(job, Training) or job.key not in self._begun:
                self._given_up.add(reference)
                ray.cancel(reference, force=True)

    def _open(self, job: Job) -> Ended | None:
        """Let the keeper hold a training's folder; returns how it ended where that cannot be."""
        if not isinstance(job, Training):
            return None
        problem: str | None = ray.get(self._keeper.open.remote(job.key, str(job.path.resolve())))
        return None if problem is None else Ended(job.key, None, problem)

    def _news(self) -> Iterator[Event]:
        reports: dict[PartKey, TrainingReport] = ray.get(self._keeper.news.remote())
        self._begun.update(reports)
        for key, report in reports.items():
            yield Advanced(key, report)

    def _ended(self, reference: Any, job: Job) -> Ended:
        try:
            ended: Ended = ray.get(reference)
        except ray.exceptions.TaskCancelledError:
            ended = Ended(job.key, None)
        except ray.exceptions.RayError as error:
            reason = f"Ray: {str(error).strip().splitlines()[0][:300]}"
            ended = Ended(job.key, None, "" if reference in self._given_up else reason)
        if isinstance(job, Training):
            ray.get(self._keeper.close.remote(job.key))
        return ended


@contextmanager
def _as_workers_need_it() -> Iterator[None]:
    """The environment that a cluster started here inherits; and Ray's handler of SIGTERM, which saves nothing, undone.

    What this process can import, its workers can; on the machines of another cluster, uavaou is installed.
    """
    before, terminated = dict(os.environ), signal.getsignal(signal.SIGTERM)
    os.environ["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, terminated)


def job_sent(job: Job) -> Job:
    """A job as it travels: a training's folder is the worker's affair."""
    return replace(job, path=Path()) if isinstance(job, Training) else job


class Keeper:
    """Writes what workers send into the run folders; an actor on the machine of the study's own process."""

    def __init__(self) -> None:
        self._open: dict[PartKey, tuple[RunFolder, ExitStack]] = {}
        self._reports: dict[PartKey, TrainingReport] = {}
        self._stopping = False

    def open(self, key: PartKey, path: str) -> str | None:
        """Hold a run folder; returns why it cannot be."""
        folder, stack = RunFolder(Path(path)), ExitStack()
        try:
            refuse_links(folder.path)
            stack.enter_context(one_writer(folder))
        except InputError as problem:
            return str(problem)
        self._open[PartKey(*key)] = folder, stack
        return None

    def close(self, key: PartKey) -> None:
        """Let go of a run folder."""
        _, stack = self._open.pop(PartKey(*key))
        stack.close()

    def fetch(self, key: PartKey) -> Files:
        """What a run folder holds; a worker goes on from it."""
        folder, _ = self._open[PartKey(*key)]
        return files_of(folder.path)

    def store(self, key: PartKey, files: Files) -> None:
        """Write files of a run, those that a checkpoint counts on before the checkpoint."""
        folder, _ = self._open[PartKey(*key)]
        for name in sorted(files, key=lambda name: name.startswith("checkpoints/")):
            path = folder.path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path, "wb") as file:
                file.write(files[name])

    def tell(self, key: PartKey, report: TrainingReport) -> bool:
        """Note how far a training is; returns whether it is to stop."""
        self._reports[PartKey(*key)] = TrainingReport(*report)
        return self._stopping

    def news(self) -> dict[PartKey, TrainingReport]:
        """What was told since the last call."""
        reports, self._reports = self._reports, {}
        return reports

    def stop(self) -> None:
        """From now on, whoever tells how far it is is told to stop."""
        self._stopping = True


def files_of(folder: Path, unless: dict[str, tuple[int, int]] | None = None) -> Files:
    """The files below a run folder that differ from the states in ``unless``, which is brought up to date."""
    files: Files = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if not path.is_file() or path.name == ".lock" or path.name.endswith(".partial"):
            continue
        state = path.stat()
        now = state.st_mtime_ns, state.st_size
        if unless is None or unless.get(name) != now:
            files[name] = path.read_bytes()
        if unless is not None:
            unless[name] = now
    return files


def _perform(job: Job, keeper: Any, plugins: Sequence[str]) -> Ended:
    """What a worker runs."""
    prepare(plugins)
    if not isinstance(job, Training):
        return outcome(job, lambda report: None)
    with tempfile.TemporaryDirectory(prefix="uavaou-") as place:
        there = _Sender(replace(job, path=Path(place) / "run"), keeper)
        there.receive()
        ended = outcome(there.job, there.tell)
        there.send()
        return ended


class _Sender:
    """Keeps the study's own folder of a run up to date with the worker's."""

    def __init__(self, job: Training, keeper: Any) -> None:
        self.job = job
        self._keeper = keeper
        self._sent: dict[str, tuple[int, int]] = {}
        self._checkpoint = 0  # when the last one that was sent had been written, ns
        self._next = 0.0

    def receive(self) -> None:
        """Fetch what was sent before."""
        files: Files = ray.get(self._keeper.fetch.remote(self.job.key))
        for name, content in files.items():
            path = self.job.path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        files_of(self.job.path, self._sent)

    def send(self) -> None:
        """Send what has changed."""
        ray.get(self._keeper.store.remote(self.job.key, files_of(self.job.path, self._sent)))

    def tell(self, report: TrainingReport) -> None:
        """Say how far the training is, send a new checkpoint, and stop where that is wanted."""
        last = RunFolder(self.job.path).last
        written = last.stat().st_mtime_ns if last.is_file() else 0
        if written != self._checkpoint:
            self._checkpoint = written
            self.send()
        if time.monotonic() < self._next:
            return
        self._next = time.monotonic() + _TELL_EVERY_S
        if ray.get(self._keeper.tell.remote(self.job.key, report)):
            signal.raise_signal(signal.SIGTERM)  # the training notes it, and makes its last checkpoint
