"""``uavaou study``: many trainings, resumable, with condensed results."""

from __future__ import annotations

import os
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaou.errors import InputError, command_line
from uavaou_cli.options import Quiet, Results, StudyName, choice, given_path, number, option, writable_folder
from uavaou_cli.progress import StudyDisplay, stopped
from uavaou_cli.tables import WIDTH, aligned, duration, interval_figures, show, wrapped

if TYPE_CHECKING:
    from uavaou.experiments.executor import Executor
    from uavaou.experiments.run import PartStatus, StudyState
    from uavaou.experiments.study import Study
    from uavaou.reports.scores import PolicyScores

MOST_JOBS = 4096


def run(
    ctx: typer.Context,
    study: StudyName,
    jobs: Annotated[int | None, number("Runs at a time, of one core each. [default: all cores]", 1, MOST_JOBS)] = None,
    engine: Annotated[str, choice("Processes of this machine, or tasks of a Ray cluster.", "local", "ray")] = "local",
    address: Annotated[
        str | None, option("Address of the Ray cluster. [default: one is started here]", "ADDRESS")
    ] = None,
    out: Results = Path("results"),
    checkpoint_every: Annotated[
        float, number("Seconds between the checkpoints of a run.", 0, 86_400, "SECONDS")
    ] = 30.0,
    quiet: Quiet = False,
) -> None:
    """Run what is left of a study: skip finished runs, resume interrupted ones from their checkpoints.

    Writes the run folders that `uavaou train` would, and DIR/studies/<name>/, the condensed results.
    """
    if address is not None and (engine != "ray" or not address.strip()):
        raise InputError(f"--address {address!r}: expected the address of a Ray cluster, with --engine ray")
    chosen, folder = _study(study, out)
    writable_folder(folder)
    from uavaou.experiments.run import run_study
    from uavaou.runs.names import uavaou_with

    if not quiet:
        for line in _time_it_takes(chosen, out, jobs or _cores()):
            print(line, file=sys.stderr)
    executor = _executor(engine, jobs, address, ctx.obj["plugins"])
    with StudyDisplay(quiet) as progress:
        try:
            outcome = run_study(chosen, out, executor, progress.show, quiet, checkpoint_every)
        except KeyboardInterrupt as error:
            raise stopped(ctx.obj["arguments"], error) from None
    for key, reason in outcome.failed.items():
        print(f"uavaou: {key} failed: {reason}", file=sys.stderr)
    if outcome.stopped_by is not None:
        kept = f" with {outcome.done} of {outcome.total} parts done"
        raise stopped(ctx.obj["arguments"], outcome.stopped_by, kept)
    place = [] if out == Path("results") else ["--out", out]
    following = [*uavaou_with(ctx.obj["plugins"]), "study", "report", study, *place]
    show([*_result_lines(folder), *_nothing_done(outcome, study, out), f"next:    {command_line(following)}"])
    if outcome.failed:
        raise typer.Exit(1)


def status(study: StudyName, out: Results = Path("results")) -> None:
    """Show how the runs of a study stand."""
    from uavaou.experiments.run import study_status

    chosen, _ = _study(study, out)
    show(_status_lines(chosen, study_status(chosen, out)))


def report(ctx: typer.Context, study: StudyName, out: Results = Path("results")) -> None:
    """Rewrite the condensed results of a study from its finished runs, its page of tables, and print the table.

    Writes README.md, marl-eval.json and one recorded mission of each variant into DIR/studies/<name>/, and the
    verdicts on the paper's claims into DIR/README.md where the study judges them. While the study runs, its tables are
    taken as they stand.
    """
    from uavaou.reports.study_report import report_study

    chosen, folder = _study(study, out)
    writable_folder(folder)
    report_study(chosen, out, lambda remark: print(f"uavaou: {remark}", file=sys.stderr), ctx.obj["plugins"])
    show([*_result_lines(folder), f"next:    {command_line(['uavaou', 'plot', 'figures', folder])}"])


def _nothing_done(state: StudyState, study: str, out: Path) -> list[str]:
    """Say that everything was there before the command, as in a fresh clone, and how it is trained all the same."""
    if state.before < state.total:
        return []
    again = command_line(["uavaou", "study", "run", study, "--out", f"{out}-again"])
    return [f"nothing was trained: all {state.total} parts have results already. All of them again:", f"  {again}"]


def _study(name: str, out: Path) -> tuple[Study, Path]:
    """The study, and the folder of its condensed results."""
    from uavaou.experiments.results import StudyFolder
    from uavaou.experiments.study import Study

    given_path("STUDY", name)
    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out}: is not a folder")
    chosen = Study.load(name)
    return chosen, StudyFolder.of(out, chosen.name).path


def _time_it_takes(study: Study, out: Path, jobs: int) -> list[str]:
    """How long the trainings that are left take, as far as such have been measured."""
    from uavaou.experiments.run import expected_cpu_s, gather

    results, _ = gather(study, out)
    cpu_s, unknown = expected_cpu_s(study, results, out)
    runs = list(study.runs())
    left = [config for key, config in runs if key not in set(results.parts)]
    if not left or not (cpu_s or unknown):
        return []
    slots = sum(config.slots for config in left)
    told = f"study {study.name}: {len(left)} of {len(runs)} trainings are left, {slots:,} slots"
    if cpu_s:
        told += f", about {duration(cpu_s)} of CPU as measured so far, {duration(cpu_s / jobs)} with --jobs {jobs}"
    if unknown:
        told += f"; not measured: {', '.join(unknown)}"
    return wrapped(told)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _executor(name: str, jobs: int | None, address: str | None, plugins: list[str]) -> Executor:
    cores = _cores()
    if name == "local":
        from uavaou.experiments.executor import Processes

        return Processes(jobs or cores, plugins)
    from uavaou.experiments.cluster import Cluster

    return Cluster(jobs if address else jobs or cores, address, plugins)


def _result_lines(folder: Path) -> list[str]:
    """The results of a study: for each scenario the mean AoU of every variant and planner, the best first."""
    from uavaou.experiments.results import read_study
    from uavaou.reports.scores import study_scores

    results = read_study(folder)
    lines = [f"study {results.settings['name']}: mean AoU in slots, {results.settings['episodes']} missions a run"]
    if not len(results.flights):
        return [*lines, "", "nothing has been evaluated yet", f"results: {folder}"]
    for scenario, found in study_scores(results).items():
        head = (scenario, "knows", "seeds", "mean AoU", "95 % interval", "violations")
        lines += ["", *aligned([head, *map(_cells, found)], left=2)]
    note = "intervals: Student's over seeds; of one seed, and of planners, a bootstrap over missions"
    if results.bounds:
        note += "; the lower bound is one on the expected mean AoU of policies that do not foresee the channel"
    return [*lines, "", *wrapped(note), f"results: {folder}"]


def _cells(one: PolicyScores) -> tuple[str, ...]:
    violations = "-" if one.violations is None else f"{one.violations:,}"
    return one.policy, one.knows, str(one.seeds or "-"), *interval_figures(one.mean), violations


def _status_lines(study: Study, parts: Sequence[PartStatus]) -> list[str]:
    """A row for each run, planner and bound, and the time left."""
    from uavaou.experiments.run import seconds_left

    states = ("finished", "trained", "running", "stopped", "failed", "waiting")
    counts = [(state, sum(part.state == state for part in parts)) for state in states]
    summary = ", ".join(f"{count} {state}" for state, count in counts if count)
    left_s = seconds_left(list(parts))
    left = f", about {duration(left_s)} left" if left_s is not None else ""
    rows = [("variant", "scenario", "seed", "slots", "state")]
    for part in parts:
        seed = "-" if part.key.seed is None else str(part.key.seed)
        slots = "-" if part.slots is None else f"{part.slots:,} of {part.budget:,}"
        by = f", {part.detail}" if part.state == "running" and part.detail else ""
        rows.append((part.key.policy, part.key.scenario, seed, slots, part.state + by))
    failed = [f"{part.key}: {part.detail}" for part in parts if part.state == "failed"]
    reasons = [line for text in failed for line in textwrap.wrap(text, WIDTH, subsequent_indent="  ")]
    head = f"study {study.name}: {len(parts)} parts, {summary}{left}"
    return [head, "", *aligned(rows), *(["", *reasons] if reasons else [])]
