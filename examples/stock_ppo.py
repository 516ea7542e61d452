"""Stable-Baselines3's own PPO, unchanged, with this project's environment and policy.

    python examples/stock_ppo.py

PPO, its rollout buffer and its training loop are Stable-Baselines3's. The policy has a centralised critic: the actor
reads a UAV's local observation, the critic the global state.
"""

from stable_baselines3 import PPO

from uavaou import flatten
from uavaou.algorithms.mappo import CentralizedValuePolicy


def mean_age(model, env):
    """Mean age of the greedy policy in the next mission of each lane, in slots."""
    rows, dones = env.reset(), [False]
    while not any(dones):
        rows, _, dones, infos = env.step(model.predict(rows, deterministic=True)[0])
    uavs, slot = env.scenario.uavs, env.scenario.slot_length_s
    ages = [info["mission"]["mean_aou_s"] / slot for info in infos[::uavs]]  # one row a mission
    return sum(ages) / len(ages)


def train(slots):
    """Train on ``quickstart`` for some slots of all missions together; returns the mean age before and after."""
    env = flatten("quickstart", missions=16, seed=0, collection="auto")
    unseen = flatten("quickstart", missions=16, seed=1_000, collection="auto")
    model = PPO(
        CentralizedValuePolicy,
        env,
        n_steps=125,
        batch_size=1000,
        n_epochs=5,
        gamma=0.98,
        policy_kwargs={"row_layout": env.row_layout},  # which columns of a row hold what
        seed=0,
        device="cpu",
    )
    before = mean_age(model, unseen)
    model.learn(slots * env.scenario.uavs)  # SB3 counts agent steps
    return before, mean_age(model, unseen)


if __name__ == "__main__":
    before, after = train(slots=60_000)
    print(f"mean age before: {before:.1f} slots")
    print(f"mean age after:  {after:.1f} slots")
