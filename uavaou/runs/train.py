"""Trains a policy into a run folder, and resumes a training from its last checkpoint."""

import signal
import sys
from contextlib import closing, nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from uavaou.algorithms.registry import make_model
from uavaou.envs.flatten import flatten
from uavaou.envs.vec_env import MissionVecEnv
from uavaou.errors import InputError, command_line
from uavaou.evaluation.seeds import training_seeds
from uavaou.files import refuse_links, replacing, write_json, writing
from uavaou.runs.checkpoint import copy_last, longest_rollout, restore
from uavaou.runs.checkpoint_header import TrainingProgress
from uavaou.runs.folder import RunConfig, RunFolder, read_config
from uavaou.runs.interrupt import Interrupted, Interrupts
from uavaou.runs.lock import one_writer
from uavaou.runs.machine import describe_machine
from uavaou.runs.pull_plan import plan_of
from uavaou.runs.recorder import CHECKPOINT_EVERY_S, AfterUpdate, Display, Recorder, agent_steps, write_meta
from uavaou.runs.released import released_names
from uavaou.runs.start import Start
from uavaou.world.pull import Plans, PullPlan

_DRAWS_COUNTED = 64  # of a family


@dataclass(frozen=True)
class Outcome:
    """How a training ended."""

    folder: RunFolder
    progress: TrainingProgress
    agent_steps: int
    stopped_by: signal.Signals | None = None  # asked to stop before the end
    update_slots: int = 0  # from one update to the next, of all missions together


def train(
    config: RunConfig,
    folder: RunFolder | Path | str,
    *,
    start: RunFolder | Path | str | None = None,
    device: str = "auto",
    backend: str = "batched",
    resume: bool = False,
    checkpoint_every_s: float = CHECKPOINT_EVERY_S,
    display: Display | None = None,
    after_update: AfterUpdate | None = None,
    plan: PullPlan | None = None,
) -> Outcome:
    """Train to the budget, writing the run folder on the way.

    Args:
        config: scenario, algorithm and seed; with several budgets, the run reaches one after the other.
        folder: of the run; must not hold one unless ``resume``.
        start: the run, or the name of the released policy, whose weights the training begins with. The optimizer
            begins anew.
        device: ``auto``, ``cpu`` or ``cuda``, for the networks.
        backend: ``batched``, or ``supersuit`` for SuperSuit's own stage.
        resume: go on from the last checkpoint.
        checkpoint_every_s: wall-clock between checkpoints; longer where writing them would take more than 2.5 % of
            it. 0: after every update.
        display: shows the training to a person; None shows nothing.
        after_update: called after each update; an exception that it raises ends the training.
        plan: that the training begins with, where it has been found before; None: it is searched.

    Raises:
        InputError: the folder holds a run already, holds another one, is written by another process, cannot be
            written or has a name that Python could not decode; the weights of ``start`` do not fit; or a loss, a
            reward or a weight is no longer finite. What the last checkpoint holds is kept.

    Examples:
        >>> from uavaou import RunConfig, train
        >>> config = RunConfig.load("mappo", "quickstart", slots=2000, evaluate_every_slots=1000)
        >>> outcome = train(config, "first-run")
        >>> outcome.folder.finished
        True
    """
    folder = folder if isinstance(folder, RunFolder) else RunFolder(Path(folder))
    refuse_links(folder.path)
    _refuse_unreadable_name(folder.path)
    source = None if start is None else Start.at(start)
    if source is not None and config.start is None:
        config = replace(config, start=source.digest)
    stages = config.stages()
    held = folder.read_config() if resume and folder.exists() else None
    for stage in stages[stages.index(held) if held in stages else 0 :]:
        arguments = folder, source, device, backend, plan
        outcome = _train(stage, *arguments, resume, checkpoint_every_s, display, after_update)
        if outcome.stopped_by is not None:
            break
        resume = True
    return outcome


def _train(
    config: RunConfig,
    folder: RunFolder,
    source: Start | None,
    device: str,
    backend: str,
    plan: Plans | None,
    resume: bool,
    checkpoint_every_s: float,
    display: Display | None,
    after_update: AfterUpdate | None,
) -> Outcome:
    """Train to the last budget of ``config``; those before it have been reached."""
    resuming = _check_folder(folder, config, resume)
    algorithm = config.algorithm
    shared = ("missions", "processes", "observation", "collection", "reward", "rows", "worlds")
    settings = {name: getattr(algorithm, name) for name in shared}
    with closing(display) if display is not None else nullcontext():
        if plan is None or resuming:
            plan = plan_of(config, folder, None if display is None else display.plan)
    try:
        env = flatten(
            config.family or config.scenario,
            seed=training_seeds(config.seed).start,
            backend=backend,
            plan=plan,
            **settings,
        )
    except MemoryError as error:
        raise InputError(f"not enough memory for missions = {algorithm.missions}: lower it") from error
    try:
        model = _make_learner(config, env, device)
        if not resuming and config.start is not None:
            _begin_with(config.start, source, model)
        with one_writer(folder.path):
            resuming = _check_folder(folder, config, resume)  # again: another process may have been here
            with writing(folder.path):
                folder.last.parent.mkdir(parents=True, exist_ok=True)
                with replacing(folder.config) as file:
                    file.write(config.to_yaml())
                if isinstance(plan, PullPlan):
                    write_json(folder.plan, plan.to_dict())
            # With worker processes, the CPU time of this one says little: it waits for those that step the missions.
            cpu_s = 0.0 if algorithm.processes == 1 else None
            started = TrainingProgress(next_evaluation=config.evaluate_every_slots, cpu_s=cpu_s)
            progress = restore(folder, model, env) if resuming else started
            return _learn(config, folder, model, env, progress, checkpoint_every_s, display, after_update)
    finally:
        env.close()


def _refuse_unreadable_name(path: Path) -> None:
    """Refuse a path that Python could not decode, such as of letters beyond ASCII where the locale is C.

    TensorBoard cannot write to it.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise InputError(
            f"'{path}': the encoding of file names is {sys.getfilesystemencoding()} here, which has not all of its "
            "letters: set PYTHONUTF8=1, or a locale of UTF-8"
        ) from error


def _begin_with(digest: str, source: Start | None, model: BaseAlgorithm) -> None:
    """Give a learner the weights of ``source``, or of the released policy, that has the ``digest``."""
    if source is None:
        source = next((start for start in map(Start.at, released_names()) if start.digest == digest), None)
    if source is None or source.digest != digest:
        found = "" if source is None else f", and those of '{source.folder}' have {source.digest[:12]}"
        raise InputError(f"the training begins with weights of digest {digest[:12]}{found}: name their run with --from")
    source.load_into(model)


def _make_learner(config: RunConfig, env: MissionVecEnv, device: str) -> BaseAlgorithm:
    try:
        model = make_model(config.algorithm, env, config.seed, device)
    except MemoryError as error:
        raise InputError("not enough memory for the learner: lower missions or what it stores of each") from error
    env.seed(training_seeds(config.seed).start)  # SB3 seeded the missions with the learner's seed
    return model


def _check_folder(folder: RunFolder, config: RunConfig, resume: bool) -> bool:
    """Whether there is a checkpoint to go on from; refuses a folder that holds a run which is not to be resumed."""
    if not folder.exists():
        return False
    if not resume:
        raise InputError(f"'{folder.path}' already holds a run: add --resume to go on with it, or choose another --out")
    held = read_config(folder.config, to_train=True)
    if config != held and config in held.stages():
        raise InputError(f"'{folder.path}' went on to {held.slots:,} slots; that one goes on with: {_going_on(folder)}")
    if held not in config.stages()[-2:]:  # as it is, or as it was at the budget before
        raise InputError(
            f"'{folder.path}' holds a run with another configuration (see its config.yaml); "
            f"that one goes on with: {_going_on(folder)}"
        )
    if folder.last.is_file() or folder.previous.is_file():
        return True
    for path in (folder.episodes, folder.progress, folder.best):
        if path.is_file() and (path == folder.best or path.read_bytes().count(b"\n") > 1):
            raise InputError(
                f"'{folder.path}' holds a run ({path.name}), but no checkpoint to go on from: restore its checkpoints, "
                "or move the folder away to begin anew"
            )
    return False


def _going_on(folder: RunFolder) -> str:
    return command_line(["uavaou", "train", "--continue", folder.path, "--resume"])


def _learn(
    config: RunConfig,
    folder: RunFolder,
    model: BaseAlgorithm,
    env: MissionVecEnv,
    progress: TrainingProgress,
    checkpoint_every_s: float,
    display: Display | None,
    after_update: AfterUpdate | None,
) -> Outcome:
    rows = env.row_layout.uavs  # of a mission
    remaining, update_slots = config.slots - progress.slots, longest_rollout(model) * config.algorithm.missions
    if remaining <= 0:  # resumed, but finished before
        with writing(folder.path):
            copy_last(folder)
        if not folder.finished:  # killed between its last checkpoint and its meta.json
            write_meta(folder, config, progress, describe_machine(), str(model.device), {})
        return Outcome(folder, progress, agent_steps(progress, config), update_slots=update_slots)
    _follow_schedules(model, config, rows)
    if folder.finished:  # with a smaller budget
        write_meta(folder, config, progress, describe_machine(), str(model.device), {})
    with Interrupts(quiet=display is None) as interrupts, closing(display) if display is not None else nullcontext():
        if display is not None:
            display.start(config.slots, progress.slots, _mean_uavs(config))
        with writing(folder.path):
            recorder = Recorder(config, folder, env, progress, display, interrupts, checkpoint_every_s, after_update)
            writers: list[KVWriter] = [recorder.progress_csv, TensorBoardOutputFormat(str(folder.path / "tensorboard"))]
        model.set_logger(Logger(str(folder.path), writers))
        try:
            # No logging by SB3: it would write a row before the update that the row is about.
            model.learn(remaining * rows, callback=recorder, log_interval=sys.maxsize, reset_num_timesteps=False)
        except Interrupted:
            pass
        except (EOFError, ConnectionError) as error:
            raise InputError(f"a worker process has ended (out of memory?); {recorder.kept}") from error
        except OSError as error:
            raise InputError(f"cannot write '{folder.path}': {error.strerror or error}; {recorder.kept}") from error
        finally:
            for end in (recorder.episodes_csv.close, model.logger.close, recorder.write_meta):
                with suppress(OSError, InputError):  # of a full disk, which has been reported above
                    end()
    return Outcome(folder, recorder.progress, recorder.agent_steps, recorder.stopped_by, update_slots)


def _mean_uavs(config: RunConfig) -> float:
    """UAVs of a mission: of a family, in the mean of some draws."""
    draws = () if config.family is None else map(config.family.draw, range(_DRAWS_COUNTED))
    return fmean([scenario.uavs for scenario in draws] or [config.scenario.uavs])


def _follow_schedules(model: BaseAlgorithm, config: RunConfig, rows: int) -> None:
    """Let the schedules of a learner stay where its first budget ended, of ``rows`` steps a slot.

    SB3 would spread them over all slots, also over those of the budgets before. A replay, which the checkpoint of a
    finished run lacks, is filled anew.
    """
    if not config.budgets:
        return

    def update(num_timesteps: int, total_timesteps: int) -> None:
        model._current_progress_remaining = 0.0

    model._update_current_progress_remaining = update  # type: ignore[method-assign]
    if isinstance(model, OffPolicyAlgorithm):
        model.learning_starts += rows * config.budgets[-2]
