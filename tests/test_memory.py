"""Memories: cells against flax and NumPy, sequences against steps, tasks that only a memory solves."""

import functools
from dataclasses import replace

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from memory_tasks import Recall, TMaze
from probe_tasks import WORLD

from pecjax.agents import AXIS, PPO, device_mesh, shard
from pecjax.agents.memory import Cell, Stack
from pecjax.agents.networks import ActorCritic, NetworkSettings, decide, forward
from pecjax.agents.ppo import agent as ppo_agent, minibatches
from pecjax.curriculum import uniform
from pecjax.errors import InputError
from pecjax.training.evaluation import make_episode_runner, stratified_config_ids

STEPS, ENVS, FEATURES, SIZE = 7, 5, 4, 6
KINDS = ("gru", "mingru")
ALL = (*KINDS, "stack")
WINDOW, STRIDE = 4, 2


def cell(kind, seed=0):
    """A cell with its parameters, all of them drawn."""
    made = Cell(kind, SIZE)
    params = made.init(jax.random.key(seed), jnp.zeros((1, 1, FEATURES)), jnp.zeros((1, SIZE)))
    draw = np.random.default_rng(seed)
    return made, jax.tree.map(lambda leaf: jnp.asarray(draw.normal(0, 0.5, leaf.shape), jnp.float32), params)


def inputs(seed=1):
    """x (L, B, F), memory (B, H), starts (L, B)."""
    draw = np.random.default_rng(seed)
    x, memory = draw.normal(0, 1, (STEPS, ENVS, FEATURES)), draw.normal(0, 1, (ENVS, SIZE))
    return jnp.float32(x), jnp.float32(memory), jnp.float32(draw.random((STEPS, ENVS)) < 0.3)


def test_the_gru_is_that_of_flax():
    ours, params = cell("gru")
    x, h, starts = inputs()
    own = params["params"]
    kernels = dict(zip("rzn", np.split(own["read"]["kernel"], 3, axis=1), strict=True))
    biases = dict(zip("rzn", np.split(own["read"]["bias"], 3), strict=True))
    recalls = dict(zip("rzn", np.split(own["recall"], 3, axis=1), strict=True))
    theirs = {f"i{gate}": {"kernel": kernels[gate], "bias": biases[gate]} for gate in "rzn"}
    theirs |= {f"h{gate}": {"kernel": recalls[gate]} for gate in "rzn"}
    theirs["hn"]["bias"] = own["recall_bias"]
    seen, last = ours.apply(params, x, h, starts)
    for time in range(STEPS):
        h = h * (1 - starts[time])[:, None]
        h, _ = nn.GRUCell(SIZE).apply({"params": theirs}, h, x[time])
        np.testing.assert_allclose(seen[time], h, atol=1e-6)
    np.testing.assert_array_equal(last, seen[-1])


def test_the_mingru_is_its_equation():
    ours, params = cell("mingru")
    x, h, starts = map(np.float64, inputs())
    kernel, bias = (np.float64(params["params"]["read"][name]) for name in ("kernel", "bias"))
    seen, _ = ours.apply(params, *inputs())
    for time in range(STEPS):
        h = h * (1 - starts[time])[:, None]
        gate, new = np.split(x[time] @ kernel + bias, 2, axis=1)
        share = 1 / (1 + np.exp(-gate))
        h = (1 - share) * np.tanh(new) + share * h
        np.testing.assert_allclose(seen[time], h, atol=1e-6)


def test_a_stack_is_what_earlier_steps_gave_in_the_same_episode():
    x, _, starts = map(np.asarray, inputs())
    earlier = np.random.default_rng(3).normal(0, 1, (WINDOW, ENVS, FEATURES)).astype(np.float32)
    seen, last = Stack(STRIDE).apply({}, x, earlier.transpose(1, 0, 2).reshape(ENVS, -1), starts)
    seen = np.asarray(seen).reshape(STEPS, ENVS, WINDOW // STRIDE, FEATURES)
    for env in range(ENVS):
        episode = [*earlier[:, env]]  # what it gave so far
        for time in range(STEPS):
            episode = [] if starts[time, env] else episode
            for tap in range(WINDOW // STRIDE):
                by = STRIDE * (tap + 1)
                wanted = episode[-by] if by <= len(episode) else np.zeros(FEATURES)
                np.testing.assert_array_equal(seen[time, env, tap], wanted)
            episode.append(x[time, env])
        kept = [np.zeros(FEATURES)] * WINDOW + episode
        np.testing.assert_array_equal(last[env].reshape(WINDOW, FEATURES), kept[-WINDOW:])


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_through_the_carry_are_those_of_finite_differences(kind):
    ours, params = cell(kind)
    x, h, starts = inputs()
    weight = jnp.float32(np.random.default_rng(2).normal(0, 1, (ENVS, SIZE)))

    def last(params, x, h):
        return (ours.apply(params, x, h, starts)[1] * weight).sum()

    check_grads(last, (params, x, h), order=1, modes=["rev"], atol=2e-2, rtol=2e-2, eps=1e-2)
    # And the first step matters to the last where no episode begins in between.
    of_first = jax.grad(lambda x: (ours.apply(params, x, h)[1] * weight).sum())(x)[0]
    assert np.abs(of_first).min() > 0


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_passes_the_beginning_of_an_episode(kind):
    ours, params = cell(kind)
    x, h, _ = inputs()
    starts = jnp.zeros((STEPS, ENVS)).at[3].set(1.0)
    across, _ = ours.apply(params, x, h, starts)
    anew, _ = ours.apply(params, x[3:], jnp.zeros_like(h))
    np.testing.assert_allclose(across[3:], anew, atol=1e-7)
    gradient = jax.grad(lambda x: ours.apply(params, x, h, starts)[1].sum())(x)
    assert not np.any(gradient[:3]) and np.abs(gradient[3:]).min(axis=(1, 2)).max() > 0


@pytest.mark.parametrize("is_privileged", [False, True])
@pytest.mark.parametrize("kind", [*KINDS, "stack"])
def test_steps_one_by_one_are_those_of_the_sequence(kind, is_privileged):
    settings = NetworkSettings(hidden=(8, 8), precision="float32", memory=kind, memory_size=SIZE)
    network = ActorCritic(settings, 3, (), is_privileged)
    x, h, starts = inputs()
    h = jnp.resize(h, (ENVS, settings.first_memory().size))
    known = x[..., :2] if is_privileged else None
    params = network.init(jax.random.key(0), x[0], None if known is None else known[0], memory=h)

    def rows(leaf):
        return None if leaf is None else leaf.reshape(STEPS * ENVS, -1)

    whole = forward(network, params, rows(x), rows(known), memory=h, starts=starts.ravel())
    for time in range(STEPS):
        h = h * (1 - starts[time])[:, None]
        seen = (x[time], None if known is None else known[time])
        decided = decide(network, params, seen[0], h)
        out = forward(network, params, *seen, memory=h)
        for of_step, of_all in zip(out[:2], whole[:2], strict=True):
            here = of_all.reshape(STEPS, ENVS, -1)[time]
            np.testing.assert_allclose(of_step.reshape(ENVS, -1), here, atol=1e-6)
        np.testing.assert_allclose(decided.params, out.params, atol=1e-6)
        np.testing.assert_allclose(decided.memory, out.memory, atol=1e-6)
        # One environment by itself, as a policy is flown.
        alone = decide(network, params, seen[0][0], h[0])
        np.testing.assert_allclose(alone.params, out.params[0], atol=1e-6)
        h = out.memory
    np.testing.assert_allclose(h, whole.memory, atol=1e-6)


REMEMBERS = PPO(
    num_envs=32,
    num_steps=8,
    num_epochs=3,
    num_minibatches=4,
    learning_rate=3e-3,
    discount=0.98,
    reward_scale=1.0,
    network=NetworkSettings(hidden=(32, 32), precision="float32", memory="gru", memory_size=16),
)


def with_memory(kind, length=None):
    """`REMEMBERS` with another memory, and sequences of so many steps."""
    network = replace(REMEMBERS.network, memory=kind, memory_stride=2)
    if kind == "stack":
        network = replace(network, memory_size=4)
    return replace(REMEMBERS, sequence_length=length, network=network)


@pytest.mark.parametrize("length", [None, 4, 1])
def test_minibatches_are_of_whole_sequences_and_every_one_is_in_one(length):
    settings = replace(REMEMBERS, sequence_length=length)
    batch = 100 * jnp.arange(8)[:, None] + jnp.arange(32)
    parts, order = minibatches.cut(settings, jax.random.key(0), batch, None)
    steps = np.asarray(parts).reshape(4, length or 8, -1)
    first = steps[:, :1]
    np.testing.assert_array_equal(steps, first + 100 * np.arange(length or 8)[:, None])
    assert sorted(parts.ravel().tolist()) == sorted(batch.ravel().tolist())
    # All sequences of an environment are in the same one, and each has one of every four in a row.
    envs = [np.unique(part % 100) for part in np.asarray(parts)]
    np.testing.assert_array_equal(np.stack(envs) // 4, np.tile(np.arange(8), (4, 1)))
    assert len({tuple(of % 4) for of in envs}) == 4
    assert sorted(order.tolist()) == sorted(3 * [0, 1, 2, 3])


def agent_of(task, settings, devices=None):
    """An agent that draws evenly, and the program of its iteration."""
    if devices is None:
        agent = settings.make(task, uniform(3))
    else:
        agent = shard(settings.make(task, uniform(3), AXIS), device_mesh(devices))
    return agent, jax.jit(agent.iterate)


def learnt(task, settings, iterations, seed=0):
    """The share of episodes that end in success, flown greedily."""
    agent, iterate = agent_of(task, settings)
    state = jax.jit(agent.init)(jax.random.key(seed), WORLD)
    for _ in range(iterations):
        state, _ = iterate(state, WORLD)
    runner = jax.jit(make_episode_runner(task, agent, greedy=True, seed=0))
    config_id = stratified_config_ids(3, 600, 0)
    return float(runner(state.learner, WORLD, config_id, jnp.arange(600)).success.mean())


@functools.cache
def decided(kind, length):
    """A learner whose actions depend on what it remembers, in the midst of episodes."""
    agent, iterate = agent_of(TMaze(), replace(with_memory(kind, length), learning_rate=0.0))
    state = jax.jit(agent.init)(jax.random.key(0), WORLD)
    # Outputs begin a hundred times smaller than the layers before them.
    params = jax.tree_util.tree_map_with_path(
        lambda path, leaf: 100 * leaf if "actor_output" in str(path) else leaf, state.learner.params
    )
    state = state._replace(learner=state.learner._replace(params=params))
    for _ in range(20):
        state, _ = iterate(state, WORLD)
    return state


@pytest.mark.parametrize("wrong", [None, "memory", "starts"])
@pytest.mark.parametrize("length", [None, 4])
@pytest.mark.parametrize("kind", ALL)
def test_the_first_look_at_a_batch_finds_the_probabilities_that_it_was_flown_by(
    kind, length, wrong, monkeypatch
):
    """Over batches that episodes cross the surrogate's ratio is 1 and KL is 0, unless a part is left out."""
    if wrong is not None:
        right = ppo_agent.prepare

        def without(*args):
            batch = right(*args)
            return batch._replace(**{wrong: jnp.zeros_like(getattr(batch, wrong))})

        monkeypatch.setattr(ppo_agent, "prepare", without)
    _, iterate = agent_of(TMaze(), replace(with_memory(kind, length), learning_rate=0.0))
    state, differences = decided(kind, length), []
    for _ in range(4):
        state, metrics = iterate(state, WORLD)
        differences.append(abs(float(metrics.losses["kl"])))
    if wrong is None:
        assert max(differences) < 1e-7
    else:
        assert min(differences) > 1e-5


@pytest.mark.parametrize(("kind", "length"), [("gru", None), ("mingru", 4), ("stack", 4)])
def test_two_devices_learn_as_one(kind, length):
    settings = with_memory(kind, length)
    one, two = agent_of(TMaze(), settings), agent_of(TMaze(), settings, 2)
    states = [jax.jit(agent.init)(jax.random.key(1), WORLD) for agent, _ in (one, two)]
    for _ in range(5):
        states = [iterate(state, WORLD)[0] for state, (_, iterate) in zip(states, (one, two), strict=True)]
    for part in ("learner", "envs"):
        of_one, of_two = (jax.tree.leaves(getattr(state, part)) for state in states)
        for a, b in zip(of_one, of_two, strict=True):
            np.testing.assert_allclose(a, b, atol=1e-5)
    assert len(states[1].envs.memory.sharding.device_set) == 2


@pytest.mark.parametrize(("kind", "length"), [("gru", None), ("mingru", 4), ("stack", 4)])
def test_runs_side_by_side_are_those_alone(kind, length):
    agent, iterate = agent_of(TMaze(), with_memory(kind, length))
    keys = jax.random.split(jax.random.key(3), 2)
    together = jax.vmap(agent.init, (0, None))(keys, WORLD)
    alone = [agent.init(key, WORLD) for key in keys]
    many = jax.jit(jax.vmap(agent.iterate, (0, None)))
    for _ in range(3):
        together, alone = many(together, WORLD)[0], [iterate(state, WORLD)[0] for state in alone]
    for number, state in enumerate(alone):
        of_many = jax.tree.map(lambda leaf, number=number: leaf[number], together)
        for a, b in zip(jax.tree.leaves(of_many.envs), jax.tree.leaves(state.envs), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-5)
    assert np.abs(together.envs.memory[0] - together.envs.memory[1]).max() > 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_a_turn_that_a_sign_at_the_beginning_tells(kind):
    """Longer than a batch, so that the memory is carried from one to the next."""
    settings = replace(REMEMBERS, num_envs=128, network=replace(REMEMBERS.network, memory=kind))
    assert learnt(TMaze(), settings, iterations=300) >= 0.99


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "delay", "iterations"),
    # At this rate a GRU that has it loses it for some iterations now and then, and finds it again.
    [("gru", 10, 100), ("gru", 50, 400), ("mingru", 10, 400), ("mingru", 50, 400)],
)
def test_a_signal_that_is_asked_for_later(kind, delay, iterations):
    network = replace(REMEMBERS.network, memory=kind)
    settings = replace(REMEMBERS, num_envs=256, num_steps=delay + 1, network=network, discount=0.999)
    assert learnt(Recall(delay), settings, iterations) >= 0.99


def test_a_stack_that_goes_back_far_enough_finds_the_signal():
    network = replace(REMEMBERS.network, memory="stack", memory_size=10, memory_stride=5)
    settings = replace(REMEMBERS, num_envs=128, network=network)
    assert learnt(Recall(10), settings, iterations=100) >= 0.99
    short = replace(settings, network=replace(network, memory_size=5))
    assert abs(learnt(Recall(10), short, iterations=100) - 0.5) < 0.1


@pytest.mark.parametrize("task", [TMaze(), Recall(10)])
def test_without_memory_it_is_a_matter_of_chance(task):
    settings = replace(REMEMBERS, num_envs=128, network=replace(REMEMBERS.network, memory=None))
    assert abs(learnt(task, settings, iterations=100) - 0.5) < 0.1


def test_settings_that_do_not_fit_are_refused():
    for change, words in (
        ({"shuffle": "samples"}, "learns from sequences"),
        ({"sequence_length": 3}, "sequences of 3 do not divide 8 steps"),
        ({"sequence_length": -8}, "sequence-length and memory-size must each be 1 or more"),
        ({"network": NetworkSettings(memory="gru", memory_size=0)}, "must each be 1 or more"),
        ({"num_minibatches": 5}, "5 minibatches do not divide 32 environments"),
        (
            {"network": NetworkSettings(memory="stack", memory_size=2)},
            "memory-stride is 4; give 1 to memory-size, 2",
        ),
    ):
        with pytest.raises(InputError, match=words):
            replace(REMEMBERS, **change).check()
