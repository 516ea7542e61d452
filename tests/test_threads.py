"""Threads of a learner: which are used, and tasks that they share."""

import multiprocessing
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest

from uavaou import InputError
from uavaou.threads import Tasks, available_threads, threads, use_threads


def test_the_number_is_chosen_or_that_of_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    cores = available_threads()
    assert threads() == cores >= 1
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert threads() == 1
    use_threads(3)
    assert threads() == 3
    use_threads(None)
    for ignored in ("", "many", "0", "1000000"):
        monkeypatch.setenv("OMP_NUM_THREADS", ignored)
        assert threads() == cores
    for number in (0, -1, 1.5, True, "2"):
        with pytest.raises(InputError, match=r"threads = .*: expected a whole number from 1 on"):
            use_threads(number)  # type: ignore[arg-type]


@pytest.mark.parametrize("number", [1, 2, 4])
def test_all_tasks_are_run_and_those_that_they_add(number: int) -> None:
    use_threads(number)
    for _ in range(200):
        done: set[int] = set()
        tasks = Tasks()

        def task(n: int, done: set[int] = done, tasks: Tasks = tasks) -> None:
            done.add(n)
            if n < 8:
                tasks.add(lambda: task(2 * n))
                tasks.add(lambda: task(2 * n + 1))

        tasks.add(lambda: task(1))
        tasks.run()
        assert done == set(range(1, 16))


def test_one_thread_runs_tasks_in_order_or_alone() -> None:
    use_threads(1)
    names: list[str] = []
    tasks = Tasks(lambda: [names.append("a"), tasks.add(lambda: names.append("c"))], lambda: names.append("b"))
    tasks.run()
    assert names == ["a", "b", "c"]
    use_threads(4)
    took: set[int] = set()
    Tasks(*[lambda: took.add(threading.get_ident())] * 50, alone=True).run()
    assert took == {threading.get_ident()}


def together(number: int) -> set[int | None]:
    """The threads that ran ``number`` tasks, each of which waits for the others."""
    barrier, took = threading.Barrier(number), set[int | None]()

    def task() -> None:
        barrier.wait(60)
        took.add(threading.current_thread().native_id)

    Tasks(*[task] * number).run()
    return took


def test_threads_work_at_the_same_time_and_are_kept() -> None:
    use_threads(3)
    first = together(3)
    assert len(first) == 3
    assert threading.current_thread().native_id in first
    before = threading.active_count()
    for _ in range(20):
        together(3)
    assert threading.active_count() == before


@pytest.mark.parametrize("in_helper", [True, False])
def test_an_exception_ends_all_after_what_has_begun(in_helper: bool) -> None:
    use_threads(2)
    own = threading.get_ident()
    barrier, ended = threading.Barrier(2), []

    def task() -> None:
        barrier.wait(60)
        if (threading.get_ident() != own) == in_helper:
            raise ZeroDivisionError("of a task")
        ended.append(True)

    tasks = Tasks(task, task)
    with pytest.raises(ZeroDivisionError, match="of a task"):
        tasks.run()
    assert ended == [True]
    assert len(together(2)) == 2  # the helper lives on


def test_two_threads_share_helpers() -> None:
    use_threads(2)

    def work(start: int) -> list[int]:
        sums = []
        for _ in range(100):
            done: list[int] = []
            Tasks(*[partial(done.append, n) for n in range(start, start + 5)]).run()
            sums.append(sum(done))
        return sums

    with ThreadPoolExecutor(2) as pool:
        for start, sums in zip((0, 50), pool.map(work, (0, 50)), strict=True):
            assert sums == [5 * start + 10] * 100


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs forked processes")
def test_a_forked_process_has_helpers_of_its_own() -> None:
    use_threads(2)
    together(2)
    child = multiprocessing.get_context("fork").Process(target=lambda: sys.exit(len(together(2))))
    child.start()
    child.join(60)
    assert child.exitcode == 2


@pytest.mark.slow
def test_a_program_that_updates_without_learning_ends() -> None:
    program = """
from uavaou import MAPPO, flatten
from uavaou.threads import use_threads
use_threads(2)
model = MAPPO(env=flatten("tiny", missions=8), n_steps=150, batch_size=700, device="cpu")
model.learn(150 * 16)
model.train()
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


def test_a_process_ends_after_its_helpers() -> None:
    # A helper that frees tensors while the interpreter is torn down ends the process by "terminate called".
    program = """
import time, threading
from uavaou.threads import Tasks, use_threads
use_threads(2)
class Slow:
    def __init__(self, barrier): self.barrier = barrier
    def __call__(self): self.barrier.wait(60)
    def __del__(self):
        time.sleep(0.5)
        print("freed", flush=True)
barrier = threading.Barrier(2)
Tasks(Slow(barrier), Slow(barrier)).run()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "freed\n" * 2
