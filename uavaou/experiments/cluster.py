"""Performs jobs on a Ray cluster, one CPU each.

Machines need not share a file system. A job works in a temporary folder of its machine and sends its files to the
keeper, an actor beside the process that submitted it, which writes them into the job's own folder and holds its lock.
When a worker dies, Ray starts its job again elsewhere, from the last files that were sent.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from uavaou.errors import InputError
from uavaou.experiments.executor import Ended, Executor, Job, StoppedEarlyError, Tell, outcome
from uavaou.files import refuse_links, replacing
from uavaou.runs.lock import one_writer

try:
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy
except ModuleNotFoundError as error:
    raise InputError(f"--engine ray: '{error.name}' is not installed: pip install 'uavaou[ray]'") from None

_LOOK_EVERY_S = 0.5
_TELL_EVERY_S = 1.0
Files = dict[str, bytes]  # path below a job's folder -> content


class Cluster(Executor):
    """Performs jobs as tasks of a Ray cluster.

    Args:
        jobs: tasks at a time; None: as many as the cluster has CPUs.
        address: of a cluster that this machine belongs to, such as ``auto``; None starts one here, for as long as the
            executor is entered.
        plugins: modules or files that register algorithms of the user's; files must exist on every machine.

    Raises:
        InputError: the cluster cannot be reached.
    """

    def __init__(self, jobs: int | None, address: str | None = None, plugins: Sequence[str] = ()) -> None:
        if address is not None and address.startswith("ray://"):
            raise InputError("--address ray://...: run the command on a machine of the cluster, with --address auto")
        local: dict[str, Any] = {"num_cpus": jobs, "include_dashboard": False} if address is None else {}
        try:
            with _as_workers_need_it():
                # Without an address Ray would join a cluster that somebody has started here, and refuse `num_cpus`.
                ray.init(address=address or "local", log_to_driver=False, logging_level="ERROR", **local)
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise InputError(f"--address {address}: no Ray cluster can be reached: {str(error)[:200]}") from error
        super().__init__(jobs or max(int(ray.cluster_resources().get("CPU", 0)), 1))
        here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
        self._keeper = ray.remote(Keeper).options(num_cpus=0, scheduling_strategy=here, max_concurrency=1).remote()
        self._plugins = [str(Path(place).resolve()) if place.endswith(".py") else place for place in plugins]
        # A killed worker is no failure of the job: it is started again, without limit.
        self._remote = ray.remote(num_cpus=1, max_retries=-1, max_calls=1)(_perform)
        self._running: list[Any] = []

    def _perform(self, job: Job, tell: Tell) -> Any:
        packed = pickle.dumps(job)
        number = ray.get(self._keeper.open.remote(None if job.folder is None else str(job.folder.resolve())))
        if isinstance(number, str):
            raise InputError(number)
        reference = self._remote.remote(packed, job.folder is not None, self._keeper, number, self._plugins)
        self._running.append(reference)
        reported, stop = False, False
        try:
            while not ray.wait([reference], timeout=_LOOK_EVERY_S)[0]:
                for report in ray.get(self._keeper.news.remote(number, stop or self.stopping)):
                    reported, stop = True, stop or bool(tell(report))
                if self.stopping and not reported:  # it has nothing to save, and may wait for a CPU for ever
                    ray.cancel(reference, force=True)
            ended: Ended = ray.get(reference)
        except ray.exceptions.RayError as error:
            if self.stopping:
                raise StoppedEarlyError from None
            raise InputError(f"Ray: {str(error).strip().splitlines()[0][:300]}") from None
        finally:
            self._running.remove(reference)
            ray.get(self._keeper.close.remote(number))
        return ended.result()

    def kill(self) -> None:
        """See :class:`Executor`."""
        for reference in list(self._running):
            ray.cancel(reference, force=True)

    def __exit__(self, *reason: object) -> None:
        super().__exit__(*reason)
        ray.shutdown()


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
    """An actor beside the process that submits: writes the files that workers send into the jobs' folders."""

    def __init__(self) -> None:
        self._folders: list[Path | None] = []  # by number of the job
        self._locks: dict[int, ExitStack] = {}
        self._reports: dict[int, list[Any]] = {}
        self._stopped: set[int] = set()

    def open(self, folder: str | None) -> int | str:
        """Lock a job's folder; returns the job's number, or the reason where it cannot."""
        stack = ExitStack()
        try:
            if folder is not None:
                refuse_links(Path(folder))
                stack.enter_context(one_writer(Path(folder)))
        except InputError as problem:
            return str(problem)
        self._folders.append(None if folder is None else Path(folder))
        self._locks[number := len(self._folders) - 1] = stack
        return number

    def close(self, number: int) -> None:
        """Unlock a job's folder."""
        self._locks.pop(number).close()

    def fetch(self, number: int) -> Files:
        """The files of a job's folder, from which a worker resumes."""
        folder = self._folders[number]
        return {} if folder is None else _changed_files(folder, {})

    def store(self, number: int, files: Files) -> None:
        """Write files of a job."""
        folder = self._folders[number]
        assert folder is not None
        _write_files(folder, files)

    def tell(self, number: int, report: Any) -> bool:
        """Note a report; returns whether the job is to stop."""
        self._reports.setdefault(number, []).append(report)
        return number in self._stopped

    def news(self, number: int, stop: bool) -> list[Any]:
        """The reports of a job since the last call; ``stop`` answers the next one with the request to stop."""
        if stop:
            self._stopped.add(number)
        return self._reports.pop(number, [])


def _write_files(folder: Path, files: Files) -> None:
    """Write files below a folder, checkpoints last: they refer to the others."""
    for name in sorted(files, key=lambda name: name.startswith("checkpoints/")):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path, "wb") as file:
            file.write(files[name])


def _changed_files(folder: Path, known: dict[str, tuple[int, int]]) -> Files:
    """The files below a folder whose time of writing or size differs from that in ``known``, which is updated."""
    files: Files = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != ".lock" and not path.name.endswith(".partial"):
            name, state = path.relative_to(folder).as_posix(), path.stat()
            now = state.st_mtime_ns, state.st_size
            if known.get(name) != now:
                files[name] = path.read_bytes()
            known[name] = now
    return files


def _perform(packed: bytes, has_folder: bool, keeper: Any, number: int, plugins: Sequence[str]) -> Ended:
    """The main function of a worker, for a pickled job."""
    if not has_folder:
        return outcome(packed, plugins, lambda report: None)
    with tempfile.TemporaryDirectory(prefix="uavaou-") as place:
        folder = Path(place) / "run"
        _write_files(folder, ray.get(keeper.fetch.remote(number)))
        sent: dict[str, tuple[int, int]] = {}
        _changed_files(folder, sent)
        next_s = 0.0  # when the next report is due

        def tell(report: Any) -> None:
            """Send what has changed and the report, and stop where that is asked for."""
            nonlocal next_s
            if time.monotonic() < next_s:
                return
            next_s = time.monotonic() + _TELL_EVERY_S
            ray.get(keeper.store.remote(number, _changed_files(folder, sent)))
            if ray.get(keeper.tell.remote(number, report)):
                signal.raise_signal(signal.SIGTERM)  # a training writes its last checkpoint

        ended = outcome(packed, plugins, tell, folder)
        ray.get(keeper.store.remote(number, _changed_files(folder, sent)))
        return ended
