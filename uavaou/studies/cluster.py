"""The engine that performs a study's jobs on a Ray cluster, one CPU each.

Machines need not share a file system. A training works in a temporary folder of its machine and sends its checkpoints
to the keeper, an actor beside the study's own process, which writes them into the run folders and holds their locks.
When a worker dies, Ray starts its job again elsewhere, from the last checkpoint that was sent.
"""

import os
import pickle
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
from uavaou.studies.folder import PartKey
from uavaou.studies.jobs import Advanced, Ended, Event, Events, Job, TakeJob, Training, TrainingReport
from uavaou.studies.processes import outcome, unpacked

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
        plugins: modules or files that register algorithms of the user's; files must exist on every machine.

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
                # Without an address Ray would join a cluster that somebody has started here, and refuse `num_cpus`.
                ray.init(address=self._address or "local", log_to_driver=False, logging_level="ERROR", **local)
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
        # A killed worker is no failure of the job: it is started again, without limit.
        perform = ray.remote(num_cpus=1, max_retries=-1, max_calls=1)(_perform)
        asked = False
        try:
            while True:
                if stopping() and not asked:
                    asked = True
                    yield from self._news()
                    self._stop(running)
                while not asked and len(running) < self._room() and (job := take()) is not None:
                    sent = job
                    if isinstance(job, Training):
                        problem = ray.get(self._keeper.open.remote(job.key, str(job.path.resolve())))
                        if problem is not None:
                            yield Ended(job.key, None, problem)
                            continue
                        sent = replace(job, path=Path())  # the worker chooses a folder of its own
                    running[perform.remote(pickle.dumps(sent), self._keeper, self._plugins)] = job
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
        """Ask trainings for their last checkpoint; give up other jobs, and trainings that wait for a CPU."""
        ray.get(self._keeper.stop.remote())
        for reference, job in running.items():
            # A training that has not reported has nothing to save, and may wait for a CPU for ever.
            if not isinstance(job, Training) or job.key not in self._begun:
                self._given_up.add(reference)
                ray.cancel(reference, force=True)

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
    """Give workers of a local cluster this import path; undo the SIGTERM handler of Ray, which saves nothing.

    The machines of another cluster have uavaou installed.
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


class Keeper:
    """An actor on the machine of the study's own process: writes the files that workers send into the run folders."""

    def __init__(self) -> None:
        self._open: dict[PartKey, tuple[RunFolder, ExitStack]] = {}
        self._reports: dict[PartKey, TrainingReport] = {}
        self._stopping = False

    def open(self, key: PartKey, path: str) -> str | None:
        """Lock a run folder; returns the reason where it cannot."""
        folder, stack = RunFolder(Path(path)), ExitStack()
        try:
            refuse_links(folder.path)
            stack.enter_context(one_writer(folder.path))
        except InputError as problem:
            return str(problem)
        self._open[key] = folder, stack
        return None

    def close(self, key: PartKey) -> None:
        """Unlock a run folder."""
        _, stack = self._open.pop(key)
        stack.close()

    def fetch(self, key: PartKey) -> Files:
        """The files of a run folder, from which a worker resumes."""
        folder, _ = self._open[key]
        return _changed_files(folder.path, {})

    def store(self, key: PartKey, files: Files) -> None:
        """Write files of a run."""
        folder, _ = self._open[key]
        _write_files(folder.path, files)

    def tell(self, key: PartKey, report: TrainingReport) -> bool:
        """Note a training's report; returns whether the training is to stop."""
        self._reports[key] = report
        return self._stopping

    def news(self) -> dict[PartKey, TrainingReport]:
        """The reports since the last call."""
        reports, self._reports = self._reports, {}
        return reports

    def stop(self) -> None:
        """Answer every further report with the request to stop."""
        self._stopping = True


def _write_files(folder: Path, files: Files) -> None:
    """Write files below a run folder, checkpoints last: they refer to the others."""
    for name in sorted(files, key=lambda name: name.startswith("checkpoints/")):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path, "wb") as file:
            file.write(files[name])


def _changed_files(folder: Path, known: dict[str, tuple[int, int]]) -> Files:
    """The files below a run folder whose time of writing or size differs from that in ``known``, which is updated."""
    files: Files = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != ".lock" and not path.name.endswith(".partial"):
            name, state = path.relative_to(folder).as_posix(), path.stat()
            now = state.st_mtime_ns, state.st_size
            if known.get(name) != now:
                files[name] = path.read_bytes()
            known[name] = now
    return files


def _perform(packed: bytes, keeper: Any, plugins: Sequence[str]) -> Ended:
    """The main function of a worker, for a pickled job."""
    job = unpacked(packed, plugins)
    if not isinstance(job, Training):
        return outcome(job, lambda report: None)
    with tempfile.TemporaryDirectory(prefix="uavaou-") as place:
        folder = RunFolder(Path(place) / "run")
        _write_files(folder.path, ray.get(keeper.fetch.remote(job.key)))
        sent: dict[str, tuple[int, int]] = {}
        _changed_files(folder.path, sent)
        checkpoint, next_s = 0, 0.0  # when the last one sent was written, ns; when the next report is due

        def send() -> None:
            ray.get(keeper.store.remote(job.key, _changed_files(folder.path, sent)))

        def tell(report: TrainingReport) -> None:
            """Send a new checkpoint and the report, and stop where the study asks for it."""
            nonlocal checkpoint, next_s
            written = folder.last.stat().st_mtime_ns if folder.last.is_file() else 0
            if written != checkpoint:
                checkpoint = written
                send()
            if time.monotonic() >= next_s:
                next_s = time.monotonic() + _TELL_EVERY_S
                if ray.get(keeper.tell.remote(job.key, report)):
                    signal.raise_signal(signal.SIGTERM)  # the training writes its last checkpoint

        ended = outcome(replace(job, path=folder.path), tell)
        send()
        return ended
