"""VDN, QMIX and IQL: mixers, the joint replay, targets by hand, exploration, what is read, and the two-step game."""

from typing import Any

import numpy as np
import pytest
import torch as th
from gymnasium import spaces

from tests.two_step_game import TwoStepGame, play_greedily
from uavaou import IQL, QMIX, VDN, InputError, Scenario, flatten
from uavaou.algorithms.qlearning.branches import UtilityNetwork
from uavaou.algorithms.qlearning.learner import JointQLearning
from uavaou.algorithms.qlearning.mixers import Mixer, MonotonicMixer, StateValueMixer, SumMixer
from uavaou.algorithms.qlearning.replay import JointReplay
from uavaou.world.views import Columns, RowLayout

LEARNERS = [VDN, QMIX, IQL]


def small_model(
    learner: type[JointQLearning] = VDN, collection: str = "select", rows: str = "flat", **arguments: Any
) -> JointQLearning:
    env = flatten(Scenario.load("quickstart").replace(slots=12), missions=4, collection=collection, rows=rows)
    quick: dict[str, Any] = {"learning_starts": 40, "batch_size": 16, "buffer_size": 400, "seed": 0, "device": "cpu"}
    return learner("JointQPolicy", env, **quick | arguments)


def test_vdn_sums_with_a_value_of_the_state_where_asked_and_iql_does_not_mix() -> None:
    utilities, states = th.randn(8, 3), th.randn(8, 4)
    th.testing.assert_close(SumMixer(3)(utilities, states)[:, 0], utilities[:, 0] + utilities[:, 1] + utilities[:, 2])
    th.testing.assert_close(Mixer(3)(utilities, states), utilities)
    policy = small_model(policy_kwargs={"state_value_width": 8}).policy
    utilities, states = th.randn(8, 2), th.randn(8, policy.row_layout.global_size)
    mixer = policy.mixer
    assert isinstance(mixer, StateValueMixer)
    value = mixer(utilities, states)[:, 0] - utilities.sum(dim=1)  # (8,) of the state alone
    th.testing.assert_close(mixer(utilities + 1, states)[:, 0], value + utilities.sum(dim=1) + 2)
    assert len(value.detach().unique()) == 8


@pytest.mark.parametrize("seed", range(5))
def test_qmix_is_monotone_in_every_utility_everywhere(seed: int) -> None:
    th.manual_seed(seed)
    mixer = MonotonicMixer(agents=3, state_size=4)
    utilities = (th.randn(500, 3) * 10).requires_grad_()
    mixer(utilities, th.randn(500, 4) * 5).sum().backward()
    assert (utilities.grad >= 0).all()
    assert (utilities.grad > 0).any()


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: small_model(policy_kwargs={"mixer": "monotone"}), "'monotonic'"),
        (lambda: small_model(buffer_size=8, n_steps=3), "replay of 8 slots"),
        (lambda: VDN("JointQPolicy", object()), "row_layout"),
    ],
)
def test_wrong_arguments_are_refused(make: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        make()


@pytest.mark.parametrize("network", [{}, {"network": "set"}, {"network": "set", "pull": 12.0}], ids=str)
@pytest.mark.parametrize(("learner", "arguments"), [(VDN, {}), (QMIX, {}), (IQL, {}), (VDN, {"state_value_width": 8})])
def test_moving_the_statistics_moves_no_prediction(
    learner: type[JointQLearning], arguments: dict[str, Any], network: dict[str, Any]
) -> None:
    rows = "entities" if network else "flat"
    model = small_model(learner, "auto" if "pull" in network else "select", rows, policy_kwargs=arguments | network)
    policy, local_size = model.policy, model.policy.row_layout.local_size
    seen = th.from_numpy(model.env.reset())
    rows, states = seen[:, :local_size], seen[::2, local_size:]
    actions = policy.act(rows, None)

    def predicted() -> tuple[th.Tensor, th.Tensor]:
        own = policy.returns.denormalise(policy.team_values(rows, states, actions))
        return own.detach(), policy.next_values(rows, states)

    before = predicted()
    policy.update_statistics(th.tensor([-40.0, -900.0, 3.0]))
    assert policy.returns.std > 100
    for old, new in zip(before, predicted(), strict=True):
        th.testing.assert_close(new, old, atol=1e-3, rtol=1e-4)


LAYOUT = RowLayout(2, 0, "auto", (Columns("who", 0, 3),), (Columns("state", 0, 1),))


def filled_replay(slots: int, capacity: int, n_steps: int, ends: set[int], missions: int = 2) -> JointReplay:
    """Slot t of mission j: state 100 j + t, local (j, u, t), action (t + u) mod 3, reward 10 j + t."""
    space, actions = spaces.Box(-1e3, 1e3, (4,), np.float32), spaces.Discrete(3)
    replay = JointReplay(
        capacity * missions, space, actions, "cpu", 2 * missions, row_layout=LAYOUT, n_steps=n_steps, gamma=0.5
    )
    who = [(j, u) for j in range(missions) for u in range(2)]
    for t in range(slots):
        rows = np.array([[j, u, t, 100 * j + t] for j, u in who], np.float32)
        chosen = np.array([(t + u) % 3 for _, u in who])
        rewards = np.array([10.0 * j + t for j, _ in who], np.float32)
        replay.add(rows, chosen, rewards, np.array([t in ends] * len(who)))
    return replay


@pytest.mark.parametrize("slots", [7, 10, 23])
def test_teammates_and_successors_stay_together(slots: int) -> None:
    replay = filled_replay(slots, capacity=10, n_steps=3, ends={4, 9, 14, 19})
    np.random.seed(0)
    batch = replay.sample(500)
    mission, start = batch.local[0::2, 0], batch.local[0::2, 2]
    th.testing.assert_close(batch.local[1::2, 0], mission)
    assert batch.local[0::2, 1].eq(0).all()
    assert batch.local[1::2, 1].eq(1).all()
    th.testing.assert_close(batch.states[:, 0], 100 * mission + start)
    th.testing.assert_close(batch.actions[0::2, 0], start.long() % 3)
    th.testing.assert_close(batch.next_states[:, 0], 100 * mission + start + 3)
    oldest, newest = max(slots - 10, 0), slots - 1
    assert set(start.tolist()) == set(range(oldest, newest - 2)), "every slot whose third successor is held, no other"


def test_returns_stop_where_the_mission_ends() -> None:
    replay = filled_replay(8, capacity=10, n_steps=3, ends={4})
    batch = replay.sample(400)
    for local, reward, discount in zip(batch.local[0::2], batch.rewards, batch.discounts, strict=True):
        mission, start = int(local[0]), int(local[2])
        window = [t for t in range(start, start + 3) if not (start <= 4 < t)]
        literal = sum(0.5**k * (10 * mission + t) for k, t in enumerate(window))
        assert float(reward) == pytest.approx(literal)
        assert float(discount) == (0.0 if start <= 4 < start + 3 else 0.125)


def test_the_targets_of_a_three_slot_mission_by_hand() -> None:
    """One agent, one state, Discrete(2): online values (1, 3) choose action 1, target values (5, 7) give it 7."""
    layout = RowLayout(1, 0, "auto", (Columns("who", 0, 1),), (Columns("state", 0, 1),))

    class OneState(TwoStepGame):
        def __init__(self) -> None:
            super().__init__(1)
            self.row_layout = layout
            self.num_envs, self.observation_space = 1, spaces.Box(0, 1, (2,), np.float32)

    model = VDN("JointQPolicy", OneState(), n_steps=1, gamma=0.5, buffer_size=20, device="cpu")
    for network, values in ((model.policy.utilities, (1.0, 3.0)), (model.policy.target_utilities, (5.0, 7.0))):
        fix_values(network, values)
    replay = model.replay_buffer
    for reward, end in ((-1.0, False), (-2.0, False), (-4.0, True), (-8.0, False)):
        replay.add(np.zeros((1, 2), np.float32), np.array([0]), np.array([reward]), np.array([end]))
    batch = replay._get_samples(np.arange(3))
    # r + gamma * 7, and the last slot's reward alone.
    th.testing.assert_close(model.targets(batch), th.tensor([[-1 + 3.5], [-2 + 3.5], [-4.0]]))
    replay.n_steps = 2
    batch = replay._get_samples(np.arange(2))
    th.testing.assert_close(model.targets(batch), th.tensor([[-1 - 0.5 * 2 + 0.25 * 7], [-2 - 0.5 * 4.0]]))


def fix_values(network: UtilityNetwork, values: tuple[float, float]) -> None:
    """Make the network give ``values`` whatever it sees."""
    middle = sum(values) / 2
    with th.no_grad():
        for head in (network.value, network.advantage):
            head.weight.zero_()
        network.value.bias.fill_(middle)
        network.advantage.bias.copy_(th.tensor(values) - middle)


@pytest.mark.parametrize("learner", LEARNERS)
@pytest.mark.parametrize("collection", ["select", "auto"])
def test_actions_read_the_local_part_alone_and_obey_the_masks(learner: type[JointQLearning], collection: str) -> None:
    model = small_model(learner, collection)
    model.learn(200)
    rows = model.env.reset()
    layout = model.policy.row_layout
    scrambled = rows.copy()
    scrambled[:, layout.local_size :] = np.random.default_rng(0).normal(size=scrambled[:, layout.local_size :].shape)
    actions, _ = model.predict(rows, deterministic=True)
    np.testing.assert_array_equal(actions, model.predict(scrambled, deterministic=True)[0])
    np.testing.assert_array_equal(actions, model.predict(rows[:, : layout.local_size], deterministic=True)[0])
    model.policy.epsilon.fill_(1.0)
    for _ in range(11):
        actions, _ = model.predict(rows, deterministic=False)
        composite = actions.reshape(len(rows), -1)
        allowed = rows[:, layout.local_columns("allowed_moves")]
        assert allowed[np.arange(len(rows)), composite[:, 0]].all()
        if collection == "select":
            assert not (composite[:, 1:] > rows[:, layout.local_columns("in_range")]).any()
        rows, *_ = model.env.step(actions)


def test_one_coin_an_agent_keeps_whole_actions_greedy() -> None:
    policy = small_model().policy
    policy.epsilon.fill_(0.25)
    local = th.ones((20_000, policy.row_layout.local_size))  # all allowed
    uniforms = th.rand((20_000, 5 + policy.row_layout.devices), generator=th.Generator().manual_seed(0))
    unchanged = (policy.act(local, uniforms) == policy.act(local, None)).all(dim=1).float().mean()
    assert float(unchanged) == pytest.approx(0.75, abs=0.02)


def test_whole_masks_are_read_where_a_row_has_them() -> None:
    layout = RowLayout(1, 0, "auto", (Columns("action_mask", 0, 5),), (Columns("state", 0, 1),))
    model = small_model()
    model.policy.row_layout = layout
    local = th.tensor([[1.0, 0.0, 1.0, 0.0, 1.0]])
    allowed = model.policy.allowed(local)
    assert allowed.tolist() == [[True, False, True, False, True]]


def test_the_same_seed_gives_the_same_weights() -> None:
    first, second, other = (small_model(QMIX, seed=seed).learn(160).policy.state_dict() for seed in (0, 0, 1))
    assert all(th.equal(first[name], second[name]) for name in first)
    assert any(not th.equal(first[name], other[name]) for name in first)


def test_the_target_networks_move_at_their_period_alone() -> None:
    model = small_model(target_update_interval=10_000, tau=1.0, train_freq=1)
    model.learn(2 * 60)
    policy = model.policy
    local = th.rand(8 * 2, policy.row_layout.local_size) + 0.6  # all allowed
    states = th.rand(8, policy.row_layout.global_size)

    def predicted(network: UtilityNetwork) -> th.Tensor:
        values = policy.branches.mean(network(local, policy.allowed(local)), th.zeros(16, 9, dtype=th.long))
        return policy.returns.denormalise(policy.mixer(values.view(8, 2), states)).detach()

    before, own = predicted(policy.target_utilities), predicted(policy.utilities)
    model.learn(400, reset_num_timesteps=False)
    th.testing.assert_close(predicted(policy.target_utilities), before, atol=1e-4, rtol=1e-4)
    assert not th.allclose(predicted(policy.utilities), own, atol=1e-3)
    policy.update_target(1.0)
    th.testing.assert_close(predicted(policy.target_utilities), predicted(policy.utilities))


@pytest.mark.slow
@pytest.mark.parametrize(("learner", "best"), [(QMIX, 8.0), (VDN, 7.0)])
def test_qmix_sees_the_8_of_the_two_step_game_and_vdn_the_7(learner: type[JointQLearning], best: float) -> None:
    returns = []
    for seed in range(2):
        settings: dict[str, Any] = {"learning_rate": 5e-3, "n_steps": 1, "buffer_size": 6_400, "learning_starts": 64}
        settings |= {"batch_size": 128, "train_freq": 1, "tau": 1.0, "target_update_interval": 20, "seed": seed}
        settings |= {"exploration_final_eps": 1.0, "policy_kwargs": {"net_arch": [64]}, "device": "cpu"}
        model = learner("JointQPolicy", TwoStepGame(32), **settings)
        model.learn(2 * 32 * 120)
        returns.append(play_greedily(model))
    assert returns == [best] * 2
