"""``save`` and ``load`` of learners without pickle: loading a stranger's file runs no code.

SB3's own ``save`` writes a zip of pickles, and its ``load`` runs the code in them. Here a learner is its weights
and optimizer in safetensors, with its constructor arguments as JSON.
"""

import inspect
import json
from io import BufferedIOBase
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import torch as th
from pydantic import Field
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecNormalize

from uavaou.algorithms.io.tensor_file import POLICY, ArrayFile, Arrays, Header, unusable, write_arrays
from uavaou.envs.spaces import action_space, row_space
from uavaou.errors import InputError
from uavaou.world.views import MOVES, RowLayout

_OPTIMIZER = "optimizer."  # prefix of the names of an optimizer's arrays
_NOT_SAVED = ("self", "policy", "env", "device", "tensorboard_log", "verbose", "_init_setup_model")


def policy_arrays(model: BaseAlgorithm) -> Arrays:
    """The policy's weights and buffers."""
    return {POLICY + name: tensor.cpu().numpy() for name, tensor in model.policy.state_dict().items()}


def optimizer_arrays(model: BaseAlgorithm) -> Arrays:
    """The optimizer's state of each parameter."""
    state = model.policy.optimizer.state_dict()["state"]
    return {
        f"{_OPTIMIZER}{index}.{name}": value.cpu().numpy()
        for index, slots in state.items()
        for name, value in slots.items()
    }


def load_policy_arrays(file: ArrayFile, model: BaseAlgorithm) -> None:
    """Load :func:`policy_arrays` from a file.

    Raises:
        InputError: its names or shapes are not the model's.
    """
    wanted, held = model.policy.state_dict(), file.part(POLICY)
    if held.keys() != wanted.keys():
        raise InputError(f"{file.path}: does not hold this policy's tensors (was it trained with other settings?)")
    for name, tensor in wanted.items():
        if held[name].shape != tuple(tensor.shape):
            raise InputError(
                f"{file.path}: {name} has shape {held[name].shape}, "
                f"this scenario and configuration need {tuple(tensor.shape)}"
            )
    model.policy.load_state_dict({name: th.from_numpy(array) for name, array in held.items()})


def load_optimizer_arrays(file: ArrayFile, model: BaseAlgorithm) -> None:
    """Load :func:`optimizer_arrays` from a file."""
    state: dict[int, dict[str, th.Tensor]] = {}
    for key, array in file.part(_OPTIMIZER).items():
        index, name = key.split(".", 1)
        state.setdefault(int(index), {})[name] = th.from_numpy(array)
    optimizer = model.policy.optimizer
    optimizer.load_state_dict(optimizer.state_dict() | {"state": state})


class LearnerHeader(Header):
    """What a learner's file states beside its arrays."""

    entry: ClassVar[str] = "about"

    learner: str = Field(alias="class")
    policy: str  # its class
    arguments: dict[str, Any]
    layout: RowLayout
    rows: Annotated[int, Field(ge=1, le=10**7)]  # buffers have as many
    num_timesteps: int
    n_updates: int


class SafeSaveLoad(BaseAlgorithm):
    """Saves and loads an SB3 learner whose policy has a ``row_layout``; comes before SB3's class among the bases.

    Arguments are saved as they were given, a schedule as its present value.
    """

    _given: dict[str, Any]

    @staticmethod
    def _policy_arguments(env: Any, given: dict[str, Any] | None, **defaults: Any) -> dict[str, Any]:
        """The policy's arguments: those given, before the defaults and what ``env`` tells."""
        if env is not None and not hasattr(env, "row_layout"):
            raise InputError(f"env = {env!r}: expected what uavaou.flatten returns, or a VecEnv with a row_layout")
        told = {} if env is None else {"row_layout": env.row_layout}
        if env is not None and env.row_layout.rows == "entities":
            told["averages_views"] = getattr(env, "maps_vary", True)
        return told | defaults | (given or {})

    @staticmethod
    def _wrap_env(env: Any, verbose: int = 0, monitor_wrapper: bool = True) -> VecEnv:
        """As SB3's, for every environment to learn on; refuses one whose rows are not ``[local | global]`` as they are.

        Raises:
            InputError: a wrapper normalises them, and so the masks in them, or gives them another size.
        """
        wrapped = wrapper = BaseAlgorithm._wrap_env(env, verbose, monitor_wrapper)
        while isinstance(wrapper, VecEnvWrapper):
            if isinstance(wrapper, VecNormalize) and wrapper.norm_obs:
                raise InputError(
                    "env: VecNormalize(norm_obs=True) changes the masks, which are columns of a row: leave it out, or "
                    "choose norm_obs=False"
                )
            wrapper = wrapper.venv
        layout = getattr(wrapped, "row_layout", None)
        if layout is not None and wrapped.observation_space.shape != row_space(layout).shape:
            raise InputError(
                f"env: its rows have the shape {wrapped.observation_space.shape}, and [local | global] has "
                f"{row_space(layout).shape}: give what uavaou.flatten returns, without a wrapper that changes rows"
            )
        return wrapped

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        """Record the arguments of the constructor."""
        learner = super().__new__(cls)
        # Without the learner itself: in a circle, its tensors would stay until Python's rare full collection.
        given = inspect.signature(cls.__init__).bind_partial(None, *args, **kwargs).arguments
        learner._given = given.pop("kwargs", {}) | given
        return learner

    def save(self, path: str | Path, exclude: Any = None, include: Any = None) -> None:  # type: ignore[override]
        """Write the learner to a safetensors file for :meth:`load`; runs have checkpoints of their own.

        Args:
            path: of the file; ``.safetensors`` is added where it has no suffix.
            exclude, include: not used; SB3's :meth:`save_sb3` takes them.

        Raises:
            InputError: an argument of the constructor is not a plain value.
            OSError: the file cannot be written.
        """
        if exclude or include:
            raise InputError("exclude, include: arguments of save_sb3; save writes what load needs")
        layout = self.policy.row_layout
        header = LearnerHeader(
            learner=type(self).__name__,
            policy=type(self.policy).__name__,
            arguments=self._plain_arguments(),
            layout=layout,
            rows=self.n_envs,
            num_timesteps=self.num_timesteps,
            n_updates=getattr(self, "_n_updates", 0),
        )
        write_arrays(_with_suffix(path), policy_arrays(self) | optimizer_arrays(self), header.text())

    @classmethod
    def load(  # type: ignore[override]
        cls, path: str | Path, env: Any = None, device: Any = "auto", policy: type[Any] | None = None, **changes: Any
    ) -> Self:
        """Read a learner that :meth:`save` wrote.

        Args:
            path: of the file.
            env: to learn on; None to predict, or to be set later.
            device: where the networks run.
            policy: the class of the saved policy; None for the learner's own.
            changes: arguments that replace the saved ones, a schedule among them.

        Raises:
            InputError: the file is missing, damaged, not a learner of this software, or a learner or policy of
                another class; or ``env`` has rows that the policy cannot read.
        """
        file = ArrayFile(_with_suffix(path))
        kind: Any = policy or next(iter(cls.policy_aliases.values()))
        header = LearnerHeader.read(file)
        for stated, wanted in ((header.learner, cls.__name__), (header.policy, kind.__name__)):
            if stated != wanted:
                raise InputError(f"{file.path}: holds a {stated!r:.40}, not a {wanted}")
        layout = header.layout if env is None else env.row_layout
        with unusable(f"{file.path}: no {cls.__name__} can be made of it"):
            arguments = header.arguments | changes
            policy_kwargs = dict(arguments.pop("policy_kwargs", None) or {})
            sized = kind.depends_on_sizes and policy_kwargs.get("network", "mlp") == "mlp"
            if not header.layout.fits(layout, sized):
                raise InputError("env: its rows are not those that the learner was saved with")
            hidden = policy_kwargs.get("net_arch") or (1,)
            file.check_holds([layout.local_size, *hidden, MOVES + layout.devices] if sized else hidden)
            arguments |= {"device": device, "policy_kwargs": policy_kwargs | {"row_layout": layout}}
            learner = cls(kind, env, _init_setup_model=env is not None, **arguments)
            if env is None:
                learner.n_envs = header.rows
                learner.observation_space, learner.action_space = row_space(layout), action_space(layout)
                learner._setup_model()
            load_policy_arrays(file, learner)
            load_optimizer_arrays(file, learner)
        learner.num_timesteps, learner._n_updates = header.num_timesteps, header.n_updates
        return learner

    def save_sb3(self, path: str | Path | BufferedIOBase, exclude: Any = None, include: Any = None) -> None:
        """Write SB3's own zip, for tools that read it. Loading such a file runs the code in it."""
        super().save(path, exclude=[*(exclude or ()), "_given"], include=include)

    def set_parameters(self, load_path_or_dict: Any, *args: Any, **kwargs: Any) -> None:
        """As SB3's, from a dict of tensors; :meth:`load` reads files."""
        if not isinstance(load_path_or_dict, dict):
            raise InputError("set_parameters: expected a dict of tensors; a file is read by load")
        super().set_parameters(load_path_or_dict, *args, **kwargs)

    def load_replay_buffer(self, *args: Any, **kwargs: Any) -> None:
        """Refused: SB3's replay files are pickles."""
        raise InputError("load_replay_buffer: reads pickles; a run's checkpoints hold its replay (train --resume)")

    def _plain_arguments(self) -> dict[str, Any]:
        given = {name: value for name, value in self._given.items() if name not in _NOT_SAVED}
        policy_kwargs = dict(given.get("policy_kwargs") or {})
        policy_kwargs.pop("row_layout", None)
        policy: Any = self.policy
        if policy.row_layout.rows == "entities":
            policy_kwargs["averages_views"] = policy.averages_views
        given["policy_kwargs"] = policy_kwargs
        for name, value in given.items():
            if callable(value) and not isinstance(value, type):  # a schedule
                given[name] = value(self._current_progress_remaining)
            try:
                json.dumps(given[name])
            except (TypeError, ValueError):
                raise InputError(f"{name} = {value!r}: only plain values can be saved") from None
        return given


def _with_suffix(path: str | Path) -> Path:
    path = Path(path)
    return path if path.suffix else path.with_suffix(".safetensors")
