"""Racers: trainings that can be stopped and looked at, ours and other people's, on our environment.

A racer is a function of (settings, rooms, seed) that returns how its policy acts, (params, obs, key) ->
action, and an iterator that trains for a stretch whenever it is asked, and gives the steps so far and the
parameters. All but Ape-X take the same settings. Each docstring names what that racer cannot do.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import queue
import threading
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from purejax_ppo import FlatRooms, make_purejax

import pecjax
from pecjax.agents import PPO, Apex
from pecjax.agents.base import AgentSettings
from pecjax.agents.networks import NetworkSettings
from pecjax.agents.observations import encode
from pecjax.envs.rooms import Rooms
from pecjax.training.build import build
from pecjax.training.program import start

STRETCH = 131_072  # steps between two looks at a policy
REWARD_SCALE = 1e-3
Act = Callable[[Any, Any, jax.Array], jax.Array]
Racer = tuple[Act, Iterator[tuple[int, Any]]]


def ours(settings: dict[str, Any], rooms: Rooms, seed: int) -> Racer:
    """pecjax's PPO with PEC, over all devices."""
    network = NetworkSettings(hidden=tuple(settings["hidden"]))
    others = {name: value for name, value in settings.items() if name != "hidden"}
    return _of_pecjax(PPO(network=network, **others), rooms, seed)


def told(settings: dict[str, Any], rooms: Rooms, seed: int) -> Racer:
    """The same with a critic that is told of the shortest paths."""
    return ours(settings, dataclasses.replace(rooms, critic_paths=True), seed)


def apex(settings: dict[str, Any], rooms: Rooms, seed: int) -> Racer:
    """pecjax's Ape-X with PEC, over all devices."""
    return _of_pecjax(Apex(**settings), rooms, seed)


def _of_pecjax(agent: AgentSettings, rooms: Rooms, seed: int) -> Racer:
    run = build(pecjax.RunSettings(task=rooms, agent=agent), len(jax.devices()))

    def train() -> Iterator[tuple[int, Any]]:
        state, iterate = start(run, seed)
        for iteration in itertools.count(1):
            state, metrics = iterate(state)
            if iteration % max(1, STRETCH // run.agent.steps_per_iteration) == 0:
                jax.block_until_ready(metrics)
                # The state is given away at the next iteration.
                yield iteration * run.agent.steps_per_iteration, jax.tree.map(jnp.copy, state.learner)

    return lambda learner, obs, key: run.agent.policy(learner, True)(obs, key), train()


def purejax(settings: dict[str, Any], rooms: Rooms, seed: int) -> Racer:
    """A loop in the manner of PureJaxRL; it knows one device."""
    env = FlatRooms(rooms, REWARD_SCALE)
    init, iterate, logits = make_purejax(env, settings)
    batch = settings["num_envs"] * settings["num_steps"]

    def train() -> Iterator[tuple[int, Any]]:
        carry, several = init(jax.random.key(seed)), max(1, STRETCH // batch)
        for number in itertools.count(1):
            for _ in range(several):
                carry = iterate(carry)
            jax.block_until_ready(carry)
            yield number * several * batch, jax.tree.map(jnp.copy, carry[0])

    return lambda params, obs, key: jnp.argmax(logits(params, env.flat(obs))), train()


def rejax(settings: dict[str, Any], rooms: Rooms, seed: int) -> Racer:
    """rejax's PPO; it knows one device."""
    import rejax as theirs
    from gymnax.environments import environment, spaces

    env = FlatRooms(rooms, REWARD_SCALE)

    class GymnaxRooms(environment.Environment):
        """Our environment as gymnax wants it, with one image a step."""

        @property
        def default_params(self):
            return environment.EnvParams(max_steps_in_episode=env.task.max_steps)

        def reset(self, key, params=None):
            return env.reset(key)

        def step(self, key, state, action, params=None):
            return *env.step(key, state, action), {}

        def observation_space(self, params):
            return spaces.Box(-10, 10, (env.size,))

        def action_space(self, params):
            return spaces.Discrete(env.task.action_space.num_actions)

    names = {"learning_rate": "learning_rate", "discount": "gamma", "entropy_coeff": "ent_coef"}
    algorithm = theirs.PPO.create(
        env=GymnaxRooms(),
        agent_kwargs={"activation": "tanh", "hidden_layer_sizes": tuple(settings["hidden"])},
        **{name: settings[name] for name in ("num_envs", "num_steps", "num_epochs", "num_minibatches")},
        **{named: settings[name] for name, named in names.items()},
        gae_lambda=0.95,
        total_timesteps=STRETCH,
        eval_freq=STRETCH,
    )
    iterate = jax.jit(algorithm.train_iteration, donate_argnums=0)
    batch = settings["num_envs"] * settings["num_steps"]

    def train() -> Iterator[tuple[int, Any]]:
        state, several = jax.jit(algorithm.init_state)(jax.random.key(seed)), max(1, STRETCH // batch)
        for number in itertools.count(1):
            for _ in range(several):
                state = iterate(state)
            jax.block_until_ready(state)
            yield number * several * batch, jax.tree.map(jnp.copy, state.actor_ts.params)

    def act(params: Any, obs: Any, key: jax.Array) -> jax.Array:
        chosen = algorithm.actor.apply(params, env.flat(obs)[None], method="_action_dist")
        return jnp.argmax(chosen.logits[0])

    return act, train()


def brax(settings: dict[str, Any], rooms: Rooms, seed: int) -> Racer:
    """Brax's PPO over all devices; continuous actions are snapped, and every reset is the first again."""
    from brax.training.agents.ppo import networks, train as brax_ppo
    from brax_rooms import BraxRooms, snapped

    scene = rooms.scenes()[0]
    env = BraxRooms(pecjax.RoomsNavigation(scene, rooms.make()[1].table, rooms))
    factory = functools.partial(
        networks.make_ppo_networks,
        policy_hidden_layer_sizes=tuple(settings["hidden"]),
        value_hidden_layer_sizes=tuple(settings["hidden"]),
        activation=jnp.tanh,
    )
    given: queue.Queue[tuple[int, Any] | Exception] = queue.Queue()
    go_on = threading.Semaphore(0)

    def hand_over(steps: int, make_policy: Any, params: Any) -> None:
        if steps:
            given.put((steps, params))
            go_on.acquire()

    batch, several = settings["num_envs"] * settings["num_steps"], 1000
    training = functools.partial(
        brax_ppo.train,
        environment=env,
        num_timesteps=max(batch, STRETCH) * several,
        num_evals=several + 1,
        run_evals=False,
        episode_length=rooms.max_steps,
        num_envs=settings["num_envs"],
        unroll_length=settings["num_steps"],
        batch_size=settings["num_envs"] // settings["num_minibatches"],
        num_minibatches=settings["num_minibatches"],
        num_updates_per_batch=settings["num_epochs"],
        learning_rate=settings["learning_rate"],
        discounting=settings["discount"],
        entropy_cost=settings["entropy_coeff"],
        clipping_epsilon=0.2,
        network_factory=factory,
        policy_params_fn=hand_over,
        seed=seed,
    )

    def train_aside() -> None:
        try:
            training()
        except Exception as error:
            given.put(error)

    def train() -> Iterator[tuple[int, Any]]:
        threading.Thread(target=train_aside, daemon=True).start()
        while True:
            there = given.get()
            if isinstance(there, Exception):
                raise there
            yield there
            go_on.release()

    network = factory(env.observation_size, env.action_size)

    def act(params: Any, obs: Any, key: jax.Array) -> jax.Array:
        flat = encode(env.inner.task.observation_space, obs)
        logits = network.policy_network.apply(params[0], params[1], flat)
        return snapped(network.parametric_action_distribution.mode(logits))

    return act, train()


def sb3(settings: dict[str, Any], rooms: Rooms, seed: int) -> Racer:
    """Stable-Baselines3's PPO over C MuJoCo, all environments in one process."""
    import stable_baselines3
    import torch
    import workloads
    from c_rooms import CRooms

    torch.set_num_threads(workloads.num_cores())
    env = pecjax.RoomsNavigation(rooms.scenes()[0], rooms.make()[1].table, rooms)
    batch = settings["num_envs"] * settings["num_steps"]
    hidden = list(settings["hidden"])
    model = stable_baselines3.PPO(
        "MlpPolicy",
        CRooms(env, settings["num_envs"]),
        n_steps=settings["num_steps"],
        batch_size=batch // settings["num_minibatches"],
        n_epochs=settings["num_epochs"],
        learning_rate=settings["learning_rate"],
        gamma=settings["discount"],
        ent_coef=settings["entropy_coeff"],
        policy_kwargs={"net_arch": {"pi": hidden, "vf": hidden}, "activation_fn": torch.nn.Tanh},
        device="cpu",
        seed=seed,
    )

    def train() -> Iterator[tuple[int, Any]]:
        while True:
            model.learn(max(batch, STRETCH), reset_num_timesteps=False)
            layers = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
            params = [
                tuple(np.array(p.detach()) for p in layer.parameters())
                for layer in layers
                if hasattr(layer, "weight")
            ]
            yield model.num_timesteps, params

    def act(params: Any, obs: Any, key: jax.Array) -> jax.Array:
        x = encode(env.task.observation_space, obs)
        for number, (weight, bias) in enumerate(params):
            x = weight @ (jnp.tanh(x) if number else x) + bias
        return jnp.argmax(x)

    return act, train()


RACERS = {
    "pecjax": ours, "told": told, "apex": apex, "purejax": purejax, "rejax": rejax, "brax": brax, "sb3": sb3
}  # fmt: skip
