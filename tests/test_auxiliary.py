"""The auxiliary task of PPO's actor: its loss by hand, what it teaches a memory, and who needs none of it."""

from dataclasses import replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from memory_tasks import Recall
from probe_tasks import WORLD, TwoStates

from pecjax.agents import AXIS, PPO, device_mesh, shard
from pecjax.agents.distributions import categorical
from pecjax.agents.networks import NetworkSettings
from pecjax.agents.ppo.agent import make_network
from pecjax.agents.ppo.update import Batch, loss
from pecjax.curriculum import uniform
from pecjax.envs.rooms import Rooms
from pecjax.envs.spaces import Box
from pecjax.errors import InputError

SETTINGS = PPO(
    num_envs=128,
    num_steps=11,
    num_minibatches=4,
    learning_rate=3e-3,
    network=NetworkSettings(hidden=(32, 32), precision="float32", memory="mingru", memory_size=16),
    auxiliary="sign",
    auxiliary_coeff=1.0,
)


class Told(Recall):
    """`Recall`, whose critics are told the signal, -1 or 1, and how late it is."""

    privileged_space: ClassVar = {"late": Box((1,)), "sign": Box((1,))}

    def privileged(self, state, params):
        late = state.steps / self.max_steps
        return {"late": late[None], "sign": (2.0 * state.signal - 1)[None]}


def trained(settings, iterations, task=None, devices=1):
    """The learner after some iterations, and the metrics of the last."""
    task = task or Told(10)
    agent = shard(settings.make(task, uniform(3), AXIS), device_mesh(devices))
    state = jax.jit(agent.init)(jax.random.key(0), WORLD)
    iterate = jax.jit(agent.iterate)
    for _ in range(iterations):
        state, metrics = iterate(state, WORLD)
    return state.learner, metrics


def test_its_loss_is_the_mean_squared_error_times_its_coefficient():
    draw = np.random.default_rng(0)
    network = make_network(Told(10), replace(SETTINGS, network=replace(SETTINGS.network, memory=None)))
    features, told = (draw.normal(0, 1, (20, size)).astype(np.float32) for size in (3, 1))
    known = np.concatenate([draw.normal(0, 1, (20, 2)), features], axis=1).astype(np.float32)
    params = network.init(jax.random.key(0), features, known)
    logits = network.apply(params, features, known).params
    log_prob = jax.nn.log_softmax(logits)[:, 0]
    zero, drawn = np.zeros(20, np.float32), np.zeros(20, np.int32)
    batch = Batch(features, known, None, drawn, logits, log_prob, zero, zero, zero, told=told)

    def total(settings, batch):
        return loss(network, categorical(2), settings, params, batch, jnp.float32(0))

    whole, terms = total(replace(SETTINGS, auxiliary_coeff=0.7), batch)
    plain, others = total(SETTINGS, batch._replace(told=None))
    layers = params["params"]
    x = features
    for name in ("actor_0", "actor_1"):
        x = np.tanh(x @ layers[name]["kernel"] + layers[name]["bias"])
    error = np.mean((x @ layers["auxiliary"]["kernel"] + layers["auxiliary"]["bias"] - told) ** 2)
    np.testing.assert_allclose(terms["auxiliary_loss"], error, rtol=1e-5)
    np.testing.assert_allclose(whole, plain + 0.7 * error, rtol=1e-5)
    assert "auxiliary_loss" not in others


def test_a_memory_learns_to_hold_what_it_predicts_and_no_other_can():
    """The signal is seen at the first of 11 steps alone; without a memory it is known in that one."""
    no_rewards = replace(SETTINGS, reward_scale=1e-9)
    _, metrics = trained(no_rewards, 40)
    assert metrics.losses["auxiliary_loss"] < 0.1
    forgets = replace(no_rewards, num_minibatches=11, network=replace(SETTINGS.network, memory=None))
    _, metrics = trained(forgets, 40)
    np.testing.assert_allclose(metrics.losses["auxiliary_loss"], 10 / 11, atol=0.05)


@pytest.mark.parametrize("critic", ["privileged", "observation"])
def test_any_critic_goes_with_it(critic):
    settings = replace(SETTINGS, network=replace(SETTINGS.network, critic=critic))
    learner, metrics = trained(settings, 1)
    assert np.isfinite(metrics.losses["auxiliary_loss"]) and "auxiliary" in learner.params["params"]


def test_two_devices_learn_as_one():
    of_one, of_two = (trained(SETTINGS, 3, devices=devices) for devices in (1, 2))
    for a, b in zip(jax.tree.leaves(of_one), jax.tree.leaves(of_two), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-5)


def test_without_it_there_is_no_layer_for_it():
    none = replace(SETTINGS, auxiliary=None)
    learner, metrics = trained(none, 1)
    assert "auxiliary" not in learner.params["params"] and "auxiliary_loss" not in metrics.losses


@pytest.mark.parametrize(
    ("task", "words"),
    [
        (Told(10), "auxiliary is path, and this task tells critics of late and sign; give one of these"),
        (TwoStates(), "auxiliary is path, and this task tells critics of nothing"),
        (Rooms().make()[0], "tells critics of drone; give one of these, path wants --task.critic-paths"),
    ],
)
def test_what_no_critic_is_told_is_refused(task, words):
    with pytest.raises(InputError, match=words):
        replace(SETTINGS, auxiliary="path").make(task, uniform(3))


def test_in_rooms_it_is_the_path():
    task, _ = Rooms(critic_paths=True).make()
    assert make_network(task, replace(SETTINGS, auxiliary="path")).num_auxiliary == 3
