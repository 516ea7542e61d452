"""VDN and QMIX on an environment of another kind: any SB3 VecEnv of teams will do (docs/how-to/extend.md).

Three operators sit at a switchboard. Each sees four lamps and sets a switch for every lamp that works, and one of three
lines to work on: MultiDiscrete([3, 2, 2, 2, 2]). A team earns the share of lamps answered rightly, and nothing while
two of it work on the same line. A shift lasts five calls.

    python examples/switchboards.py
"""

from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from uavaou import VDN
from uavaou.world.views import Columns, RowLayout

OPERATORS, LINES, LAMPS, CALLS = 3, 3, 4, 5
OPTIONS = LINES + 2 * LAMPS


class Switchboards(VecEnv):
    """Teams side by side: rows are team-major, ``[local | global]``."""

    def __init__(self, teams: int, seed: int = 0) -> None:
        self.teams = teams
        self.rng = np.random.default_rng(seed)
        self.row_layout = RowLayout(  # which columns of a row hold what
            uavs=OPERATORS,  # agents of a team
            devices=0,
            collection="auto",
            local=(Columns("id", 0, 3), Columns("lamps", 3, 7), Columns("action_mask", 7, 7 + OPTIONS)),
            state=(Columns("lamps", 0, OPERATORS * LAMPS),),
        )
        columns = self.row_layout.local_size + self.row_layout.global_size
        actions = spaces.MultiDiscrete([LINES] + [2] * LAMPS)
        super().__init__(teams * OPERATORS, spaces.Box(0.0, 1.0, (columns,), np.float32), actions)

    def rows(self) -> np.ndarray:
        """Draw the lamps of the next call, and show them."""
        shape = (self.teams, OPERATORS, LAMPS)
        self.works = self.rng.random(shape) < 0.8
        self.lamps = (self.rng.random(shape) < 0.5) & self.works
        mask = np.ones((self.teams, OPERATORS, OPTIONS))
        mask[..., LINES + 1 :: 2] = self.works  # the switch of a broken lamp stays off
        ids = np.broadcast_to(np.eye(OPERATORS), (self.teams, OPERATORS, OPERATORS))
        state = np.repeat(self.lamps.reshape(self.teams, 1, -1), OPERATORS, axis=1)
        return np.concatenate([ids, self.lamps, mask, state], axis=2, dtype=np.float32).reshape(self.num_envs, -1)

    def reset(self) -> np.ndarray:
        self.call = 0
        return self.rows()

    def step_async(self, actions: np.ndarray) -> None:
        self.actions = actions.reshape(self.teams, OPERATORS, 1 + LAMPS)

    def step_wait(self) -> Any:
        lines = np.sort(self.actions[..., 0], axis=1)
        apart = (np.diff(lines, axis=1) > 0).all(axis=1)
        right = (self.actions[..., 1:] == self.lamps).mean(axis=(1, 2))
        reward = np.repeat(np.where(apart, right, 0.0), OPERATORS).astype(np.float32)  # the team's, for each agent
        self.call = (self.call + 1) % CALLS
        done = np.full(self.num_envs, self.call == 0)  # all agents of a team end together, and it begins anew
        return self.rows(), reward, done, [{} for _ in range(self.num_envs)]

    def close(self) -> None:
        pass

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        return [getattr(self, method_name)(*args, **kwargs)] * self.num_envs

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


def mean_reward(model: VDN, calls: int = 100) -> float:
    """Of a call, with greedy actions, on shifts that were not trained on."""
    boards = Switchboards(teams=32, seed=1)
    rows, total = boards.reset(), 0.0
    for _ in range(calls):
        boards.step_async(model.predict(rows, deterministic=True)[0])
        rows, rewards, _, _ = boards.step_wait()
        total += float(rewards.mean())
    return total / calls


if __name__ == "__main__":
    model = VDN(
        "JointQPolicy", Switchboards(teams=32), gamma=0.0, n_steps=1, buffer_size=20_000, learning_starts=500,
        batch_size=256, train_freq=1, learning_rate=2e-3, policy_kwargs={"net_arch": [64, 64]}, seed=0, device="cpu",
    )  # fmt: skip
    print(f"before: {mean_reward(model):.3f} of 1 a call")
    model.learn(32 * OPERATORS * 1_000)
    print(f"after:  {mean_reward(model):.3f}")
