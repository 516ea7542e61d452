"""Peak memory of a training process in MiB, first and last: ``python -m benchmarks.memory mappo 6``."""

from __future__ import annotations

import json
import resource
import sys

from uavaou import flatten
from uavaou.algorithms.registry import load_config, make_model


def main() -> None:
    name, rollouts = sys.argv[1], int(sys.argv[2])
    config = load_config(name)
    env = flatten("paper", missions=config.missions, collection=config.collection, rows=config.rows)
    model = make_model(config, env, seed=0, device="cpu")
    steps = 125 * env.num_envs  # a rollout of MAPPO's
    peaks = []
    for done in range(rollouts):
        model.learn(steps, reset_num_timesteps=done == 0)
        peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    print(json.dumps([peaks[0], peaks[-1]]))


if __name__ == "__main__":
    main()
