"""PPO: its loss against rlax and against a float64 transcription, its epochs, and whole iterations."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
import rlax
from every_axis import write_table
from jax.sharding import PartitionSpec
from probe_tasks import TARGET_WORLD, WORLD, CutOff, Target, TwoStates
from scipy import stats
from scipy.special import log_softmax
from scipy.stats import entropy as scipy_entropy
from test_returns import cut_batch, episode_by_episode

import pecjax
from pecjax.agents import AXIS, PPO, device_mesh, shard
from pecjax.agents.distributions import categorical, tanh_normal
from pecjax.agents.networks import ActorCritic, NetworkSettings, forward
from pecjax.agents.ppo import minibatches, update as ppo_update
from pecjax.agents.ppo.update import Batch, Flown
from pecjax.agents.rollout import Trajectory
from pecjax.curriculum import PEC
from pecjax.envs.axes import fill
from pecjax.envs.rooms.settings import Rooms
from pecjax.envs.spaces import Box
from pecjax.envs.task import World
from pecjax.training.presets import PRESETS

RLLIB = PRESETS["rllib085"].agent
ROWS, ACTIONS = 64, 15
OF_ACTIONS = categorical(ACTIONS)

# Stands in for a network: its parameters are the logits and values themselves.
IDENTITY = SimpleNamespace(apply=lambda params, *_: (*params, None, None))


def of_drawn(logits, drawn):
    """Log-probabilities (N,) of what was drawn (N,) by logits (N, A)."""
    return np.float32(log_softmax(np.float64(logits), axis=-1)[np.arange(len(drawn)), drawn])


def random_batch(seed: int):
    """A batch, and new (logits, value) for it: some beyond every clip, others within."""
    draw = np.random.default_rng(seed)

    def normal(scale, *shape):
        return draw.normal(0, scale, shape).astype(np.float32)

    old = normal(1, ROWS, ACTIONS)
    drawn = draw.integers(0, ACTIONS, ROWS).astype(np.int32)
    value = normal(300, ROWS)
    batch = Batch(
        features=None,
        known=None,
        columns=None,
        drawn=drawn,
        params=old,
        log_prob=of_drawn(old, drawn),
        value=value,
        advantage=normal(1, ROWS),
        target=value + normal(30, ROWS),
    )
    return batch, (old + normal(0.4, ROWS, ACTIONS), value + normal(12, ROWS))


def rllib_loss(batch: Batch, logits, value, kl_coeff: float, settings: PPO) -> float:
    """RLlib 0.8.5, `PPOLoss`, in float64."""
    new, old = log_softmax(np.float64(logits), axis=1), log_softmax(np.float64(batch.params), axis=1)
    rows = np.arange(len(value))
    ratio = np.exp(new[rows, batch.drawn] - old[rows, batch.drawn])
    surrogate = np.minimum(
        batch.advantage * ratio,
        batch.advantage * np.clip(ratio, 1 - settings.clip_epsilon, 1 + settings.clip_epsilon),
    )
    kl = np.sum(np.exp(old) * (old - new), axis=1)
    entropy = -np.sum(np.exp(new) * new, axis=1)
    value, value_old, target = (np.float64(x) for x in (value, batch.value, batch.target))
    bound = np.inf if settings.value_clip is None else settings.value_clip
    clipped = value_old + np.clip(value - value_old, -bound, bound)
    value_error = np.maximum((value - target) ** 2, (clipped - target) ** 2)
    per_row = (
        -surrogate + kl_coeff * kl + settings.value_coeff * value_error - settings.entropy_coeff * entropy
    )
    return per_row.mean()


def our_loss(settings: PPO, batch: Batch, params, kl_coeff: float = 0.0):
    return ppo_update.loss(IDENTITY, categorical(ACTIONS), settings, params, batch, jnp.float32(kl_coeff))


LOSSES = {
    "rllib085": RLLIB,
    "fast": PPO(),
    "all terms": replace(RLLIB, value_coeff=0.7, entropy_coeff=0.3, clip_epsilon=0.1),
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", LOSSES)
def test_whole_loss_equals_rllibs_formula(name, seed):
    settings = LOSSES[name]
    batch, params = random_batch(seed)
    total, _ = our_loss(settings, batch, params, kl_coeff=1.7)
    weight = 0.0 if settings.kl_coeff is None else 1.7
    np.testing.assert_allclose(total, rllib_loss(batch, *params, weight, settings), rtol=2e-6)


@pytest.mark.parametrize("name", LOSSES)
def test_gradient_equals_finite_differences_of_that_formula(name):
    settings = LOSSES[name]
    batch, params = random_batch(seed=7)
    of_logits, of_value = jax.grad(lambda p: our_loss(settings, batch, p, 1.7)[0])(params)
    weight = 0.0 if settings.kl_coeff is None else 1.7

    def slope(array: int, where: tuple, width: float) -> float:
        ends = []
        for sign in (1, -1):
            moved = [np.float64(p) for p in params]
            moved[array][where] += sign * width
            ends.append(rllib_loss(batch, *moved, weight, settings))
        return (ends[0] - ends[1]) / (2 * width)

    for row in range(0, ROWS, 4):
        column = (row, (row * 7 + int(batch.drawn[row])) % ACTIONS)
        # The loss is about 1e3, so float64 differences hold some nine digits of these slopes.
        np.testing.assert_allclose(of_logits[column], slope(0, column, 1e-4), rtol=1e-3, atol=1e-7)
        np.testing.assert_allclose(of_value[row], slope(1, (row,), 1e-3), rtol=1e-3, atol=1e-6)


def test_value_gradient_is_zero_exactly_where_the_clipped_error_is_the_larger():
    batch, (logits, value) = random_batch(seed=3)
    gradient = jax.grad(lambda v: our_loss(RLLIB, batch, (logits, v))[0])(value)
    move = value - batch.value
    held = np.abs(move) > 10
    towards = np.abs(batch.value + np.clip(move, -10, 10) - batch.target) > np.abs(value - batch.target)
    stopped = held & towards
    assert 5 < stopped.sum() < ROWS - 5
    np.testing.assert_array_equal(gradient[stopped], 0)
    free = ~stopped  # 2 (V - R) over the rows, without a half
    np.testing.assert_allclose(gradient[free], (2 * (value - batch.target) / ROWS)[free], rtol=1e-5)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # rlax's word about its own KL
def test_terms_equal_rlax_and_scipy(seed):
    batch, params = random_batch(seed)
    _, terms = our_loss(RLLIB, batch, params)
    rows = np.arange(ROWS)
    new, old = jax.nn.softmax(params[0]), jax.nn.softmax(batch.params)
    ratio = new[rows, batch.drawn] / old[rows, batch.drawn]
    surrogate = rlax.clipped_surrogate_pg_loss(ratio, jnp.asarray(batch.advantage), RLLIB.clip_epsilon)
    # Means of 64 float32 numbers near 1; the surrogate's cancel, hence its absolute tolerance.
    np.testing.assert_allclose(terms["policy_loss"], surrogate, rtol=1e-5, atol=1e-6)
    kl = rlax.categorical_kl_divergence(jnp.asarray(batch.params), jnp.asarray(params[0])).mean()
    np.testing.assert_allclose(terms["kl"], kl, rtol=1e-4)
    np.testing.assert_allclose(terms["entropy"], scipy_entropy(np.float64(new), axis=1).mean(), rtol=1e-5)


def test_terms_of_continuous_actions_equal_scipys():
    draw = np.random.default_rng(4)
    box = Box((2,), -2.0, 2.0)
    of, (old, new) = tanh_normal(box), draw.normal(0, 0.5, (2, ROWS, 4)).astype(np.float32)
    noise = draw.normal(size=(ROWS, 2)).astype(np.float32)
    advantage, value = draw.normal(size=(2, ROWS)).astype(np.float32)
    drawn = of.draw(old, noise)
    batch = Batch(None, None, None, drawn, old, of.log_prob(old, drawn), value, advantage, value)
    settings = replace(RLLIB, entropy_coeff=0.2)
    total, terms = ppo_update.loss(IDENTITY, of, settings, (new, value), batch, jnp.float32(1.7))

    def normal(params):
        mean, raw = np.split(np.float64(params), 2, axis=-1)
        return stats.norm(mean, np.log1p(np.exp(raw)) + 1e-3)

    # The squashing is the same to both, and cancels.
    drawn = np.float64(batch.drawn)
    ratio = np.exp((normal(new).logpdf(drawn) - normal(old).logpdf(drawn)).sum(axis=-1))
    surrogate = rlax.clipped_surrogate_pg_loss(jnp.float32(ratio), jnp.asarray(advantage), 0.2)
    np.testing.assert_allclose(terms["policy_loss"], surrogate, rtol=1e-4, atol=1e-6)
    assert 5 < (np.abs(ratio - 1) > 0.2).sum() < ROWS - 5
    np.testing.assert_allclose(terms["kl"], of.kl(old, new).mean(), rtol=1e-5)
    np.testing.assert_allclose(terms["entropy"], of.entropy(new, old, batch.drawn).mean(), rtol=1e-5)
    expected = terms["policy_loss"] + 1.7 * terms["kl"] - 0.2 * terms["entropy"]
    np.testing.assert_allclose(total, expected, rtol=1e-5)


def trajectory_of(rewards, values, dones, bootstrap=None) -> Trajectory:
    logits = np.zeros((*values.shape, ACTIONS), np.float32)
    drawn = np.zeros(values.shape, np.int32)
    return Trajectory(None, drawn, rewards, dones, bootstrap, Flown(None, None, drawn, logits, values))


def random_trajectory(scale: float = 500.0):
    draw = np.random.default_rng(5)
    rewards, values = draw.normal(-1, scale, (2, 20, 6)).astype(np.float32)
    dones = (draw.random((20, 6)) < 0.1).astype(np.float32)
    return trajectory_of(rewards, values, dones), draw.normal(0, scale, 6).astype(np.float32)


def prepared(settings, trajectory, last_value, devices: int):
    if devices == 1:
        return ppo_update.prepare(settings, OF_ACTIONS, trajectory, last_value, None)
    over_envs = PartitionSpec(None, AXIS)
    return jax.shard_map(
        lambda t, v: ppo_update.prepare(settings, OF_ACTIONS, t, v, AXIS),
        mesh=device_mesh(devices),
        in_specs=(over_envs, PartitionSpec(AXIS)),
        out_specs=over_envs,
        check_vma=False,
    )(trajectory, last_value)


@pytest.mark.parametrize("devices", [1, 2])
@pytest.mark.parametrize("reward_scale", [1.0, 1e-3])
def test_advantages_are_standardised_over_the_whole_batch(devices, reward_scale):
    settings = replace(RLLIB, reward_scale=reward_scale)
    trajectory, last_value = random_trajectory()
    batch = prepared(settings, trajectory, last_value, devices)
    values = jnp.concatenate([trajectory.extras.value, last_value[None]])
    raw = jax.vmap(rlax.truncated_generalized_advantage_estimation, (1, 1, None, 1), 1)(
        reward_scale * trajectory.reward, 0.99 * (1 - trajectory.done), 0.95, values
    )
    raw = np.float64(raw)
    np.testing.assert_allclose(batch.advantage, (raw - raw.mean()) / raw.std(), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(batch.target, raw + values[:-1], rtol=1e-4, atol=1e-2)


@pytest.mark.parametrize("devices", [1, 2])
def test_advantages_reach_beyond_cuts_in_what_the_learner_sees_of_rewards(devices):
    rewards, values, dones, bootstrap = cut_batch(seed=9)
    rewards, values, dones, bootstrap = rewards[:, :4], values[:, :4], dones[:, :4], bootstrap[:, :4]
    settings = replace(RLLIB, reward_scale=0.01)
    trajectory = trajectory_of(100 * rewards, values[:-1], dones, bootstrap)
    batch = prepared(settings, trajectory, values[-1], devices)
    raw = np.float64(episode_by_episode(rewards, values, dones, bootstrap, 0.99, 0.95))
    np.testing.assert_allclose(batch.advantage, (raw - raw.mean()) / raw.std(), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(batch.target, raw + values[:-1], rtol=1e-4, atol=1e-2)


@pytest.mark.parametrize("devices", [1, 2])
def test_a_tiny_deviation_counts_as_a_ten_thousandth(devices):
    trajectory, last_value = random_trajectory(scale=1e-6)
    dones = np.ones_like(trajectory.done)  # advantage = reward - value
    batch = prepared(RLLIB, trajectory._replace(done=dones), last_value, devices)
    raw = np.float64(trajectory.reward) - trajectory.extras.value
    # The rewards lie around -1 with a spread of 1e-6, of which float32 keeps 6e-8.
    np.testing.assert_allclose(batch.advantage, (raw - raw.mean()) / 1e-4, atol=2e-3)
    assert batch.advantage.std() < 0.05


@pytest.mark.parametrize("iterations", [1, 3])
def test_the_rate_falls_to_a_tenth_over_decay_steps(iterations):
    """Adam's updates by one gradient, beside those at a constant rate."""
    updates = iterations * SMALL.num_epochs * SMALL.num_minibatches
    decay = replace(SMALL, decay_steps=iterations * SMALL.num_envs * SMALL.num_steps)
    gradient = {"w": jnp.asarray([1.0, -2.0])}

    def moves(settings):
        optimizer = ppo_update.make_optimizer(settings)
        state, found = optimizer.init(gradient), []
        for _ in range(2 * updates):
            change, state = optimizer.update(gradient, state)
            found.append(change["w"])
        return np.stack(found)

    part = np.minimum(np.arange(2 * updates) / updates, 1)
    expected = np.stack([1 - 0.9 * part] * 2, axis=1)
    np.testing.assert_allclose(moves(decay) / moves(SMALL), expected, rtol=1e-5)


@pytest.mark.parametrize("shuffle", ["steps", "samples"])
def test_an_iteration_takes_the_updates_that_the_rate_falls_by(shuffle):
    settings = replace(SHUFFLES[shuffle], decay_steps=10_000)
    agent = made(settings, TwoStates(), WORLD)
    state, _ = jax.jit(agent.iterate)(agent.init(jax.random.key(0), WORLD), WORLD)
    found = optax.tree_utils.tree_get_all_with_path(state.learner.optimizer, "count")
    assert [int(count) for _, count in found] == 2 * [settings.num_epochs * settings.num_minibatches]


@pytest.mark.parametrize(
    ("kl", "factor"),
    [(0.0, 0.5), (0.00499, 0.5), (0.005, 1), (0.01, 1), (0.02, 1), (0.02001, 1.5), (1.0, 1.5)],
)
def test_kl_coefficient_by_hand(kl, factor):
    for before in (0.2, 1.0):
        after = ppo_update.adapt_kl_coeff(jnp.float32(before), jnp.float32(kl), 0.01)
        np.testing.assert_allclose(after, before * factor, rtol=1e-6)


def test_a_kl_coefficient_that_halves_for_ever_can_still_rise():
    weight = jnp.float32(0.2)
    for _ in range(200):
        weight = ppo_update.adapt_kl_coeff(weight, jnp.float32(0.0), 0.01)
    assert 0 < weight < 1e-29
    assert ppo_update.adapt_kl_coeff(weight, jnp.float32(1.0), 0.01) == 1.5 * weight
    # Where there is no such term its weight is 0 and stays there.
    assert ppo_update.adapt_kl_coeff(jnp.float32(0.0), jnp.float32(1.0), 0.01) == 0


def minibatch_rows(settings, key, num_rows):
    """The rows of every minibatch of every epoch."""
    rows, order = minibatches.shuffle(settings, key, num_rows)
    return np.asarray(rows[order])


def test_samples_are_shuffled_once_and_then_only_their_parts():
    rows = minibatch_rows(RLLIB, jax.random.key(0), 5000)
    assert rows.shape == (30 * 39, 128)
    epochs = [[tuple(part) for part in epoch] for epoch in rows.reshape(30, 39, 128)]
    assert all(set(epoch) == set(epochs[0]) for epoch in epochs)
    assert len({tuple(epoch) for epoch in epochs}) == 30
    # 5000 = 39 × 128 + 8: every row at most once, and not simply the last ones left out
    assert len(np.unique(rows[:39])) == 39 * 128
    assert rows.min() >= 0 and rows.max() < 5000
    other = minibatch_rows(RLLIB, jax.random.key(1), 5000)
    dropped = [set(range(5000)) - set(r[:39].ravel().tolist()) for r in (rows, other)]
    assert dropped[0] != dropped[1] and set(range(4992, 5000)) not in dropped
    assert abs(np.corrcoef(rows[:39].ravel(), np.arange(4992))[0, 1]) < 0.1


def test_the_shuffles_of_one_key_are_independent():
    """The order of the parts must not follow from the draw that made them."""
    key = jax.random.key(4)
    settings = replace(RLLIB, num_minibatches=50, num_epochs=8)
    rows = minibatch_rows(settings, key, 50)  # parts of a single row
    first, *others = rows.reshape(8, 50)
    # Were an epoch's order drawn with the key of the one shuffle p, it would be p of p.
    for once in jax.random.split(key, 8):
        permuted = np.asarray(jax.random.permutation(once, 50))
        for epoch in (first, *others):
            assert not np.array_equal(epoch, permuted[permuted])


def test_steps_are_cut_once_and_all_used_in_every_epoch():
    settings = PPO(num_steps=32, num_epochs=6, num_minibatches=8)
    rows = minibatch_rows(settings, jax.random.key(0), 32)
    assert rows.shape == (6 * 8, 4)
    epochs = rows.reshape(6, 32)
    np.testing.assert_array_equal(np.sort(epochs, axis=1), np.tile(np.arange(32), (6, 1)))
    assert len({frozenset(map(frozenset, e.reshape(8, 4).tolist())) for e in epochs}) == 1
    assert len({tuple(epoch) for epoch in epochs}) == 6
    other = minibatch_rows(settings, jax.random.key(1), 32)
    assert set(map(frozenset, rows.tolist())) != set(map(frozenset, other.tolist()))


def test_the_preset_rllib085_holds_every_value_of_rllib_and_of_the_paper():
    preset, found = PRESETS["rllib085"], RLLIB
    assert isinstance(found, PPO)
    assert found.learning_rate == 5e-5 and found.decay_steps is None and found.adam_eps == 1e-8
    assert found.num_envs * found.num_steps == 5000  # train_batch_size
    assert 5000 // found.num_minibatches == 128 and found.num_minibatches == 39  # sgd_minibatch_size
    assert found.num_epochs == 30  # num_sgd_iter
    assert found.num_minibatches * found.num_epochs == 1170  # Adam steps an iteration
    assert found.shuffle == "samples"
    assert found.kl_target == 0.01 and found.kl_coeff == 1.0
    assert found.value_clip == 10 and found.value_coeff == 1.0 and found.entropy_coeff == 0
    assert found.discount == 0.99 and found.gae_lambda == 0.95 and found.clip_epsilon == 0.2
    assert found.max_grad_norm is None and found.reward_scale == 1.0
    assert found.network == NetworkSettings(
        encoder="mlp", hidden=(256, 256), initializer="normc", critic="observation", precision="float32"
    )
    assert preset.stop.iterations == 1500 and preset.sampler == PEC(alpha=0.2)
    assert preset.evaluation.every == 100 and preset.evaluation.episodes == 50
    assert preset.task == pecjax.Rooms()  # the paper's six rooms and set 1
    jax.tree.map(np.testing.assert_array_equal, preset.task.configurations(), pecjax.COORDINATE_SET_1)


# Goals one metre away, three of them near a wall, so that episodes end within a few steps.
NEAR = pecjax.Configurations(
    np.array([[0, -2], [5, -2.4], [-5, -2], [6, -1]], np.float32),
    np.array([[1, -2], [5, -3.4], [-5, -1], [7, -1]], np.float32),
)
SMALL = PPO(
    num_envs=128,
    num_epochs=4,
    num_minibatches=4,
    learning_rate=1e-3,
    discount=0.99,
    # What devices sum up in another order would be rounded to another number of 8 bits.
    network=NetworkSettings(precision="float32", hidden=(32,)),
)
# A ratio at the border of the clip falls on either side of it by its last digit, which decides a gradient.
UNCLIPPED = replace(SMALL, clip_epsilon=9.0)
SHUFFLES = {
    "steps": SMALL,
    "samples": replace(SMALL, shuffle="samples", num_epochs=2, kl_coeff=1.0, value_clip=0.1),
}


@pytest.fixture(scope="module")
def near_world(scene):
    """The task on `NEAR`, and its world."""
    env = pecjax.RoomsNavigation(scene, fill(NEAR), pecjax.NavigationSettings(max_steps=100))
    return env.task, World(env.params, env.configurations)


def made(settings, task, world, devices=None):
    """An agent of this task, unsharded where devices is None."""
    sampler = pecjax.curriculum.pec(jax.tree.leaves(world.table)[0].shape[0], 0.2)
    if devices is None:
        return settings.make(task, sampler)
    return shard(settings.make(task, sampler, AXIS), device_mesh(devices))


@pytest.fixture(scope="module")
def small(near_world):
    """The unsharded agent of `SMALL`, compiled: init and iterate, of key and state alone."""
    task, world = near_world
    agent = made(SMALL, task, world)
    init, iterate = jax.jit(agent.init), jax.jit(agent.iterate)
    return lambda key: init(key, world), lambda state: iterate(state, world)


def assert_trees_close(one, other, atol):
    def close(a, b):
        if jnp.issubdtype(a.dtype, jax.dtypes.prng_key):
            a, b = jax.random.key_data(a), jax.random.key_data(b)
        if jnp.issubdtype(a.dtype, jnp.floating):
            np.testing.assert_allclose(a, b, rtol=1e-4, atol=atol)
        else:
            np.testing.assert_array_equal(a, b)

    jax.tree.map(close, one, other)


def assert_learn_alike(one_agent, many_agent, world, iterations):
    """Iteration by iteration; returns the trials, and the last state of the agent on many devices.

    Every iteration begins with the same learner, since what rounding leaves of it grows from one to
    the next: Adam divides by gradients that grow small, and a draw near its edge falls either way.
    """
    iterate, together = jax.jit(one_agent.iterate), jax.jit(many_agent.iterate)
    one, many = jax.jit(one_agent.init)(jax.random.key(0), world), many_agent.init(jax.random.key(0), world)
    for _ in range(iterations):
        same = jax.tree.map(lambda a, b: jax.device_put(a, b.sharding), one.learner, many.learner)
        (one, of_one), (many, of_many) = iterate(one, world), together(many._replace(learner=same), world)
        np.testing.assert_array_equal(one.envs.running.config_id, many.envs.running.config_id)
        np.testing.assert_array_equal(one.counts, many.counts)
        assert_trees_close(one.learner, many.learner, atol=1e-6)
        # Lengths of metres and returns of thousands, after 100 physics steps in float32.
        assert_trees_close(one.envs, many.envs, atol=1e-4)
        assert_trees_close((one.sampler, one.key), (many.sampler, many.key), atol=0)
        assert_trees_close(of_one, of_many, atol=1e-4)
    return int(one.counts[0].sum()), many


def hear(agent_settings, batches):
    """What a sampler hears of each batch, (signal, done, length), and the last state."""
    inner = pecjax.curriculum.uniform(jax.tree.leaves(WORLD.table)[0].shape[0])
    shape = (agent_settings.num_steps, agent_settings.num_envs)
    nothing = tuple(jnp.zeros(shape, kind) for kind in (jnp.float32, bool, jnp.int32))
    sampler = inner._replace(
        init=lambda: (inner.init(), nothing),
        probabilities=lambda state: inner.probabilities(state[0]),
        sample=lambda state, key, shape=(): inner.sample(state[0], key, shape),
        update=lambda state, heard, axis_name=None: (state[0], (heard.signal, heard.done, heard.length)),
    )
    agent = agent_settings.make(TwoStates(), sampler)
    iterate, state = jax.jit(agent.iterate), jax.jit(agent.init)(jax.random.key(0), WORLD)
    heard = []
    for _ in range(batches):
        state, _ = iterate(state, WORLD)
        heard.append(jax.tree.map(np.asarray, state.sampler[1]))
    return heard, state


def test_a_sampler_hears_the_mean_advantage_of_every_episode():
    """What is positive and what is negative of it add up to its absolute value, across batches too."""
    kinds = (
        "positive_value_loss",
        "negative_value_loss",
        "value_loss",
        "maximised_negative_advantage",
    )
    short = replace(SMALL, num_steps=4)  # episodes take several batches
    heard = [hear(replace(short, signal=kind), batches=6)[0] for kind in kinds]
    lengths, fell = [], False
    for (up, done, length), (down, *_), (both, *_), (kept, *_) in zip(*heard, strict=True):
        np.testing.assert_allclose((up + down)[done], both[done], rtol=1e-4, atol=1e-7)
        assert (up[done] >= 0).all() and (down[done] >= 0).all()
        assert (kept[done] >= down[done] - 1e-6).all()
        fell |= (down[done] > 0).any()
        lengths.extend(length[done])
    assert max(lengths) > 4 and fell


def test_a_sampler_hears_what_the_errors_of_an_episode_come_to():
    """Of a learner that stands still, with λ = 0: one of the few courses of that length is what was heard."""
    parts = {
        "positive_value_loss": lambda error: np.maximum(error, 0),
        "negative_value_loss": lambda error: np.maximum(-error, 0),
        "value_loss": np.abs,
        "maximised_negative_advantage": lambda error: np.maximum(-error, 0),
    }
    still = replace(SMALL, num_steps=4, learning_rate=0.0, gae_lambda=0.0, reward_scale=0.5)
    found = {kind: hear(replace(still, signal=kind), batches=6) for kind in parts}
    params = found["value_loss"][1].learner.params
    first, second = np.asarray(forward(ActorCritic(still.network, 2, ()), params, jnp.eye(2))[1], float)
    pay, discount = still.reward_scale, still.discount
    stay_first, go_on = 0.1 * pay + (discount - 1) * first, discount * second - first
    stay_second, leave = -0.1 * pay + (discount - 1) * second, pay - second

    def courses(length):
        yield [stay_second] * (length - 1) + [leave]
        for stays in range(length - 1):
            yield [stay_first] * stays + [go_on] + [stay_second] * (length - 2 - stays) + [leave]

    done, length = (np.concatenate([row[n] for row in found["value_loss"][0]]) for n in (1, 2))
    heard = {kind: np.concatenate([row[0] for row in rows])[done] for kind, (rows, _) in found.items()}
    assert max(length[done]) > 4
    for place, steps in enumerate(length[done]):
        expected = [[part(np.array(c)).mean() / pay for part in parts.values()] for c in courses(int(steps))]
        off = np.abs(np.array(expected) - [heard[kind][place] for kind in parts]).max(axis=1)
        assert off.min() < 1e-5


def test_a_sampler_hears_the_mean_value_of_every_episode_in_units_of_the_reward():
    """Of a learner that stands still: an episode of n steps has been in B a whole number of them."""
    still = replace(SMALL, num_steps=4, signal="value", learning_rate=0.0, reward_scale=0.01)
    heard, state = hear(still, batches=6)
    first, second = forward(ActorCritic(still.network, 2, ()), state.learner.params, jnp.eye(2))[1] / 0.01
    signal, length = (np.concatenate([row[n][row[1]] for row in heard]) for n in (0, 2))
    in_second = length * (signal - first) / (second - first)
    np.testing.assert_allclose(in_second, np.round(in_second), atol=2e-3)
    assert (np.round(in_second) >= 1).all() and (np.round(in_second) <= length).all() and max(length) > 4


@pytest.mark.parametrize("devices", [pytest.param(2, marks=pytest.mark.slow), 4])
def test_many_devices_learn_as_one(devices):
    """In a task whose numbers are exact, so that all that differs is the rounding of sums over devices."""
    many = made(SMALL, TwoStates(), WORLD, devices)
    trials, state = assert_learn_alike(made(SMALL, TwoStates(), WORLD), many, WORLD, iterations=20)
    assert trials > SMALL.num_envs  # so that drawing anew was part of it
    # Sharing the environments is the point of it.
    assert len(state.envs.running.config_id.sharding.device_set) == devices


@pytest.mark.slow
def test_two_devices_fly_and_learn_as_one(near_world):
    """In flight, for as long as no ray passes an edge: there a position's last digit decides what is seen."""
    one, two = made(UNCLIPPED, *near_world), made(UNCLIPPED, *near_world, devices=2)
    trials, _ = assert_learn_alike(one, two, near_world[1], iterations=6)
    assert trials > SMALL.num_envs


@pytest.mark.slow
def test_two_devices_fly_with_every_axis_as_one(tmp_path):
    """Gusts, noise, dropout, late actions and objectives are drawn and kept by environment, not by device."""
    task, world = Rooms(table=str(write_table(tmp_path / "axes.csv")), max_steps=100).make()
    one, two = made(UNCLIPPED, task, world), made(UNCLIPPED, task, world, devices=2)
    trials, _ = assert_learn_alike(one, two, world, iterations=6)
    assert trials > SMALL.num_envs


@pytest.mark.parametrize(
    ("shuffle", "num_minibatches"), [("steps", 4), ("samples", 4), ("samples", 5)]
)  # 128 / 5: parts of 25 rows, which two devices cannot halve
def test_two_devices_take_the_same_minibatches_as_one(shuffle, num_minibatches):
    """One update of the learner on one batch, whose environments two devices share."""
    settings = replace(SHUFFLES[shuffle], num_minibatches=num_minibatches)
    draw = np.random.default_rng(9)

    def normal(*shape):
        return jnp.asarray(draw.normal(0, 1, (16, 8, *shape)), jnp.float32)

    features = normal(3 * 4 + 3)
    action = jnp.asarray(draw.integers(0, ACTIONS, (16, 8)), jnp.int32)
    logits = normal(ACTIONS)
    log_prob = OF_ACTIONS.log_prob(logits, action)
    batch = Batch(features, None, None, action, logits, log_prob, normal(), normal(), normal())
    network = ActorCritic(settings.network, ACTIONS, ((3, 4),))
    optimizer = optax.adam(settings.learning_rate)
    params = jax.jit(network.init)(jax.random.key(0), features)
    learner = ppo_update.Learner(params, optimizer.init(params), jnp.float32(1.0))
    key = jax.random.key(1)

    def update(learner, batch, axis_name=None):
        return ppo_update.update(
            network, categorical(ACTIONS), optimizer, settings, learner, batch, key, axis_name
        )

    everywhere = PartitionSpec()
    shared = jax.shard_map(
        lambda learner, batch: update(learner, batch, AXIS),
        mesh=device_mesh(2),
        in_specs=(everywhere, PartitionSpec(None, AXIS)),
        out_specs=everywhere,
        check_vma=False,
    )
    one, two = jax.jit(update)(learner, batch), jax.jit(shared)(learner, batch)
    assert_trees_close(one, two, atol=1e-6)
    moved = jax.tree.map(lambda a, b: float(jnp.abs(a - b).max()), one[0].params, params)
    assert min(jax.tree.leaves(moved)) > 1e-4


@pytest.mark.slow
def test_seeds_may_be_vmapped(near_world, small):
    task, world = near_world
    init, iterate = small
    agent = made(SMALL, task, world)
    keys = jax.random.split(jax.random.key(8), 2)
    together = jax.jit(jax.vmap(agent.init, (0, None)))(keys, world)
    many = jax.jit(jax.vmap(agent.iterate, (0, None)))
    alone = [init(key) for key in keys]
    for _ in range(2):
        together, metrics = many(together, world)
        for seed in range(2):
            alone[seed], expected = iterate(alone[seed])
            state, found = jax.tree.map(lambda leaf, seed=seed: leaf[seed], (together, metrics))
            assert_trees_close(state.learner, alone[seed].learner, atol=1e-6)
            assert_trees_close(state.envs, alone[seed].envs, atol=1e-4)
            np.testing.assert_array_equal(state.counts, alone[seed].counts)
            np.testing.assert_array_equal(found.reported, expected.reported)
    assert np.any(together.counts[0] != together.counts[1])


@pytest.mark.slow
def test_it_learns_to_reach_a_goal_one_metre_away(small):
    init, iterate = small
    state, ratios = init(jax.random.key(0)), []
    for _ in range(60):
        state, metrics = iterate(state)
        trials, failures = np.asarray(metrics.reported)
        ratios.append(1 - failures / trials)
    # Chance comes to about 0.3; seeds 0, 1 and 2 were seen to end at 1.00, 0.99 and 0.87.
    assert np.mean(ratios[:5]) < 0.5
    assert np.mean(ratios[-5:]) > 0.75


TINY = PPO(
    num_envs=64,
    num_steps=10,
    num_epochs=4,
    num_minibatches=2,
    learning_rate=3e-3,
    discount=0.9,
    entropy_coeff=0.0,
    reward_scale=1.0,
    network=NetworkSettings(hidden=(16,)),
)


def learnt(settings, task, world, iterations):
    """The agent, its learner and the metrics of each iteration."""
    agent = made(settings, task, world)
    iterate, state = jax.jit(agent.iterate), jax.jit(agent.init)(jax.random.key(0), world)
    metrics = []
    for _ in range(iterations):
        state, of_this = iterate(state, world)
        metrics.append(of_this)
    return agent, state, metrics


@pytest.mark.parametrize("params", [0.8, -1.5])
def test_it_learns_continuous_actions_that_depend_on_the_configuration(params):
    world = TARGET_WORLD._replace(params=jnp.float32(params))
    agent, state, metrics = learnt(TINY, Target(), world, iterations=150)
    greedy, drawn = (jax.jit(agent.policy(state.learner, greedy)) for greedy in (True, False))
    for number in range(3):
        obs = jnp.float32([number - 1])
        target = [params * (number - 1), 1.0]
        np.testing.assert_allclose(greedy(obs, jax.random.key(0)), target, atol=0.1)
        several = jax.vmap(drawn, (None, 0))(obs, jax.random.split(jax.random.key(1), 100))
        assert (np.abs(several) <= 2).all() and several.std(axis=0).min() > 1e-3
    mean_distance = [of.sums["distance"] / of.episodes for of in metrics]
    assert mean_distance[0] > 1 > 0.3 > mean_distance[-1]
    # Every step is an episode, and its own metric and flag are of it.
    assert metrics[0].episodes == metrics[0].reported[0] == TINY.num_envs * TINY.num_steps
    reported = np.sum([of.reported for of in metrics], axis=0)
    assert state.counts.sum(axis=1).tolist() == [*reported.tolist(), reported[0]]


class Uncut(CutOff):
    """The same, whose cuts are taken for endings."""

    truncates = False


def value_of(task, settings, iterations=150):
    _, state, _ = learnt(settings, task, WORLD, iterations)
    network = ActorCritic(settings.network, 2, ())
    return float(forward(network, state.learner.params, jnp.ones(1))[1])


@pytest.mark.parametrize("gae_lambda", [0.95, 0.0])
def test_values_reach_across_a_cut_and_no_further_than_an_ending(gae_lambda):
    """Whoever sees five steps of 1 each has to know that they go on."""
    settings = replace(TINY, gae_lambda=gae_lambda, learning_rate=1e-2)
    assert abs(value_of(CutOff(), settings) - 10) < 0.3
    # Five steps at most are worth 4.1; all of them look alike, and that is the mean of what each sees.
    value = value_of(Uncut(), settings)
    assert abs(value - mean_value_of_five_steps(gae_lambda)) < 0.3 and value < 4.2


def mean_value_of_five_steps(gae_lambda, discount=0.9):
    """Where the targets' mean is what is predicted of every step."""
    guess = 0.0
    for _ in range(500):
        advantage, targets = 0.0, []
        for left in range(1, 6):
            ahead = discount if left > 1 else 0.0
            advantage = 1 + ahead * guess - guess + ahead * gae_lambda * advantage
            targets.append(guess + advantage)
        guess = np.mean(targets)
    return guess


def test_minibatches_must_fit(near_world):
    with pytest.raises(pecjax.InputError, match="5 minibatches do not divide 32 steps"):
        made(replace(SMALL, num_minibatches=5), *near_world)
    with pytest.raises(pecjax.InputError, match="4097 minibatches"):
        made(replace(SHUFFLES["samples"], num_minibatches=4097), *near_world)


def test_what_cannot_be_learnt_is_refused():
    cnn = replace(TINY, network=NetworkSettings(encoder="cnn"))
    with pytest.raises(pecjax.InputError, match="needs an image among the observations; choose mlp"):
        made(cnn, TwoStates(), WORLD)

    class Boundless(Target):
        action_space = Box((2,))

    with pytest.raises(pecjax.InputError, match="no policy for the action space"):
        made(TINY, Boundless(), TARGET_WORLD)
