"""Studies on processes and on a Ray cluster: interrupted, killed, and gone on with, they end as the untouched one."""

import importlib.util
import json
import multiprocessing
import os
import pickle
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from filelock import FileLock

from tests.command_line import start_command
from tests.experiments.small import assert_same_tables
from tests.runs.stopped_runs import without_wall
from uavaou import read_study
from uavaou.experiments.executor import Executor, Processes, _work
from uavaou.experiments.jobs import Bound, Training, TrainingReport
from uavaou.experiments.run import StudyState, run_study
from uavaou.experiments.study import Study
from uavaou.runs.lock import holder
from uavaou.runs.names import config_folder
from uavaou_cli.main import main

SMALL = (
    "missions: 8, rollout_slots: 20, batch_rows: 160, hidden: [16], evaluation_missions: 2, "
    "evaluate_every_slots: 1600, plan_slots: 0"  # so that both begin at once
)
PACED = ["tests.experiments.paced"]
SLOTS = 3200  # 20 updates
LONG = f"""
slots: {SLOTS}
seeds: 1
scenarios: [quickstart]
variants:
  mappo: {{set: {{{SMALL}}}}}
  ippo: {{set: {{{SMALL}}}}}
planners: [greedy]
episodes: 4
"""


def wait_for_missions(process: Any, out: Path, runs: int, missions: int) -> list[Path]:
    """Wait until that many runs of a study's process have played that many missions; returns their folders."""
    deadline = time.monotonic() + 300
    while process.exitcode is None and time.monotonic() < deadline:
        found = [path for path in out.glob("*/*/seed-*/episodes.csv") if path.read_text().count("\n") > missions]
        if len(found) >= runs:
            return [path.parent for path in found]
        time.sleep(0.05)
    raise AssertionError(f"the runs did not begin; the exit status is {process.exitcode}")


def assert_the_same(one: Path, other: Path, study: Study) -> None:
    """The same episodes and evaluations in all runs, and the same condensed figures."""
    for _, config in study.runs():
        ours, theirs = (config_folder(place, config).path for place in (one, other))
        assert without_wall(ours / "episodes.csv") == without_wall(theirs / "episodes.csv")
        assert without_wall(ours / "progress.csv") == without_wall(theirs / "progress.csv")
    assert_same_tables(one, other, study.name)


@pytest.fixture(scope="module")
def untouched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Study]:
    """The study, run without a stop, once for all processes of the tests."""
    own = tmp_path_factory.getbasetemp()
    place = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "untouched-study"
    with FileLock(f"{place}.lock"):
        place.mkdir(exist_ok=True)
        (place / "long.yaml").write_text(LONG)
        study = Study.load(place / "long.yaml")
        ended = run_study(study, place / "out", Processes(2), lambda state: None, quiet=True)  # or finds it finished
        assert ended.failed == {}
    return place, study


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "to", "code", "engine"),
    [
        (signal.SIGTERM, os.killpg, 143, ""),  # to the children too
        (signal.SIGKILL, os.kill, -signal.SIGKILL, ""),
        (signal.SIGINT, os.killpg, 130, " --engine ray"),
    ],
)
def test_every_run_saves_when_its_study_is_stopped_and_the_same_command_goes_on(
    number: signal.Signals, to: Any, code: int, engine: str, untouched: tuple[Path, Study], tmp_path: Path
) -> None:
    if engine:
        pytest.importorskip("ray")
    place, study = untouched
    line = f"study run {place / 'long.yaml'} --jobs 2 --quiet --out {tmp_path / 'out'}"
    slow = f"--plugin tests.experiments.slow {line}{engine}"
    process = start_command(slow, tmp_path / "stderr")
    folders = wait_for_missions(process, tmp_path / "out", 2, 7)
    to(process.pid, number)
    process.join(120)
    assert process.exitcode == code
    deadline = time.monotonic() + 60
    while any(holder(folder / ".lock") for folder in folders) and time.monotonic() < deadline:
        time.sleep(0.1)
    said = (tmp_path / "stderr").read_text()
    assert said.count("\n") == (code > 0), said  # of one that is killed, nobody is there to hear the runs
    assert code < 0 or said.split("to go on: uavaou ")[1] == f"{slow}\n"
    metas = [json.loads((folder / "meta.json").read_text()) for folder in folders]
    assert all(0 < meta["slots"] < SLOTS for meta in metas)
    assert main(shlex.split(line)) == 0  # without the cluster and the pace
    assert_the_same(tmp_path / "out", place / "out", study)
    if number == signal.SIGTERM:
        again = [json.loads((folder / "meta.json").read_text()) for folder in folders]
        assert all(after["cpu_s"] > meta["cpu_s"] > 0 for after, meta in zip(again, metas, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("what", ["a training", "a bound"])
def test_a_job_finishes_silently_when_the_study_process_is_gone(
    what: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "long.yaml").write_text(LONG.replace(str(SLOTS), "640").replace("[quickstart]", "[tiny]"))
    _, config = next(iter(Study.load(tmp_path / "long.yaml").runs()))
    job = Training(config, tmp_path / "run", 2) if what == "a training" else Bound(config.scenario)
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(pickle.dumps(job), theirs, []))
    process.start()
    ours.close()  # before it can have said anything
    theirs.close()
    process.join(120)
    assert process.exitcode == 0
    assert capfd.readouterr().err == ""
    if what == "a training":
        meta = json.loads((tmp_path / "run/meta.json").read_text())
        assert meta["finished"]
        assert (tmp_path / "run/flights.csv.gz").is_file()


@pytest.mark.slow
def test_jobs_have_one_thread() -> None:
    code = (
        "from uavaou.experiments.executor import outcome; outcome(b'', [], print);"
        "from uavaou import flatten, threads; import torch;"
        "torch.set_num_threads(2); flatten('tiny'); print(threads.threads(), torch.get_num_threads())"
    )
    surroundings = os.environ | {"OMP_NUM_THREADS": "2", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    run = subprocess.run([sys.executable, "-c", code], env=surroundings, capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["1", "1"]


def test_a_queued_job_of_a_cluster_is_cancelled(monkeypatch: pytest.MonkeyPatch) -> None:
    """It may wait for a CPU for ever; a training that has reported is asked for its last checkpoint."""
    ray = pytest.importorskip("ray")
    from uavaou.experiments import cluster

    cancelled: list[str] = []
    reports = {"begun": [[TrainingReport(640, None, "process 1")], [], []], "queued": [[], [], []]}
    asked: list[tuple[str, bool]] = []

    def news(number: str, stop: bool) -> list[TrainingReport]:
        asked.append((number, stop))
        return reports[number].pop(0)

    remote = {name: SimpleNamespace(remote=lambda *_: 0) for name in ("open", "close", "news")}
    keeper = SimpleNamespace(**remote)
    waits = iter([[], [], ["done"]] * 2)
    fake = SimpleNamespace(
        get=lambda value: cluster.Ended(1) if value == "reference" else value,
        exceptions=ray.exceptions,
        cancel=lambda reference, force: cancelled.append(asked[-1][0]),
        wait=lambda *_, timeout: (next(waits), []),
    )
    monkeypatch.setattr(cluster, "ray", fake)
    executor = object.__new__(cluster.Cluster)
    executor.stopping, executor._keeper, executor._plugins, executor._running = True, keeper, [], []
    executor._remote = SimpleNamespace(remote=lambda *_: "reference")
    config = next(iter(Study.load("smoke").runs()))[1]
    keeper.news.remote = lambda number, stop: news("queued", stop)
    assert executor._perform(Bound(config.scenario), lambda report: None) == 1
    assert cancelled == ["queued", "queued"]
    keeper.news.remote = lambda number, stop: news("begun", stop)
    assert executor._perform(Training(config, Path("run"), 2), lambda report: None) == 1
    assert cancelled == ["queued", "queued"]
    assert all(stop for _, stop in asked)


def process_of(worker: str) -> int:
    """The number of the process that a report is by."""
    return int(worker.split()[1])


class Killing(Executor):
    """Kills the process of each training with SIGKILL once, in the middle; another executor performs the jobs."""

    def __init__(self, executor: Executor, times: int) -> None:
        super().__init__(1)
        self._executor, self._times = executor, times
        self.killed: list[int] = []
        self.workers: dict[str, set[str]] = defaultdict(set)  # of each training

    def submit(self, job: Any, tell: Any = lambda report: None) -> Future[Any]:
        def told(report: TrainingReport) -> Any:
            self._look(job.config.algorithm.name, report)
            return tell(report)

        return self._executor.submit(job, told)

    def _look(self, algorithm: str, report: TrainingReport) -> None:
        self.workers[algorithm].add(report.by)
        process = process_of(report.by)
        if len(self.killed) < self._times and report.slots >= SLOTS // 3 and process not in self.killed:
            os.kill(process, signal.SIGKILL)
            self.killed.append(process)

    def _perform(self, job: Any, tell: Any) -> Any:
        raise NotImplementedError

    def kill(self) -> None:
        self._executor.kill()


def ignore(state: StudyState) -> None:
    """Show nothing."""


@pytest.mark.slow
def test_a_killed_process_is_a_failure_that_the_same_command_repairs(
    untouched: tuple[Path, Study], tmp_path: Path
) -> None:
    place, study = untouched
    executor = Killing(Processes(2, PACED), times=1)
    ended = run_study(study, tmp_path, executor, ignore, quiet=True, checkpoint_every_s=0.2)
    (reason,) = ended.failed.values()
    assert "ended by SIGKILL" in reason
    assert ended.done == 2
    assert run_study(study, tmp_path, Processes(2), ignore, quiet=True).failed == {}
    assert_the_same(tmp_path, place / "out", study)


class LosingNode(Killing):
    """Also loses a node, as soon as two other workers than the killed one are at work; the first waits for the second.

    Without the wait it may have finished its training by then, on a fast machine.
    """

    def __init__(self, executor: Executor, lose: Callable[[], None]) -> None:
        super().__init__(executor, times=1)
        self._lose = lose
        self.lost_at: dict[str, int] = {}  # slots of each worker
        self._working: dict[str, int] = {}
        self._one = threading.Lock()

    def _look(self, algorithm: str, report: TrainingReport) -> None:
        with self._one:
            super()._look(algorithm, report)
            if self.lost_at:
                return
            self._working[report.by] = report.slots
            alive = {by: slots for by, slots in self._working.items() if process_of(by) not in self.killed}
            if self.killed and len(alive) == 2:
                self._lose()
                self.lost_at = alive
            if self.killed:
                for by in alive:
                    with suppress(ProcessLookupError):  # its node is lost
                        os.kill(process_of(by), signal.SIGCONT if self.lost_at else signal.SIGSTOP)


@pytest.mark.slow
def test_a_killed_worker_and_a_lost_node_of_a_cluster_are_replaced_and_their_runs_resume(
    untouched: tuple[Path, Study], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster as Nodes

    from uavaou.experiments.cluster import Cluster

    place, study = untouched
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))  # uavaou is on every node
    nodes = Nodes(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        second = nodes.add_node(num_cpus=1)
        with Cluster(None, nodes.address, PACED) as cluster:
            executor = LosingNode(cluster, lambda: nodes.remove_node(second, allow_graceful=False))
            ended = run_study(study, tmp_path, executor, ignore, quiet=True, checkpoint_every_s=0.2)
    finally:
        nodes.shutdown()
    assert ended.failed == {}
    assert ended.done == 3
    assert len(executor.killed) == 1
    assert all(slots < SLOTS for slots in executor.lost_at.values())
    # Two trainings were handed over: that of the killed worker, and that of the lost node, maybe to a worker in use.
    assert sum(len(workers) - 1 for workers in executor.workers.values()) >= 2
    assert_the_same(tmp_path, place / "out", study)


@pytest.mark.slow
def test_a_cluster_is_started_beside_one_that_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    ray = pytest.importorskip("ray")
    from uavaou.experiments.cluster import Cluster

    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:1")  # as of a cluster that `ray start` began
    with Cluster(jobs=1):
        assert ray.cluster_resources()["CPU"] == 1


def test_a_cluster_without_ray_is_refused_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "uavaou.experiments.cluster", raising=False)
    assert main(shlex.split(f"study run smoke --engine ray --out {tmp_path / 'out'}")) == 2
    assert "pip install 'uavaou[ray]'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "plain_ppo.py"
STUDY = """
description: A plain PPO
slots: 96
seeds: 1
scenarios: [tiny]
variants:
  plain: {algorithm: plain-ppo, set: {missions: 4, rollout_slots: 24, minibatches: 2, evaluation_missions: 2}}
planners: [stay]
episodes: 2
"""


@pytest.mark.slow
@pytest.mark.parametrize(("plugin", "engine"), [("own_ppo", "local"), ("own_ppo.py", "ray")])
def test_a_study_trains_what_a_plugin_registers(plugin: str, engine: str, tmp_path: Path) -> None:
    if importlib.util.find_spec("ray") is None and engine == "ray":
        pytest.skip("ray is not installed")
    shutil.copy(EXAMPLE, tmp_path / "own_ppo.py")
    (tmp_path / "mine.yaml").write_text(STUDY)
    command = ["--plugin", plugin, "study", "run", "mine.yaml", "--jobs", "1", "--engine", engine, "--quiet"]
    surroundings = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    ran = subprocess.run(
        [sys.executable, "-m", "uavaou", *command], cwd=tmp_path, env=surroundings, capture_output=True, text=True
    )
    assert (ran.returncode, ran.stderr) == (0, "")
    results = read_study(tmp_path / "results" / "studies" / "mine")
    assert len(results.trainings("plain", "tiny")) == 1
