"""Tasks as environments of gymnax and of Gymnasium."""

import importlib
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pecjax
from pecjax.envs.task import num_configs, take_configs
from pecjax.errors import InputError


@pytest.fixture(scope="module")
def rooms(gliding):
    """Episodes of 20 steps. What is tested here does not depend on how the drone flies."""
    return pecjax.Rooms(max_steps=20).make()


@pytest.fixture(scope="module")
def puck():
    """Numbers for actions, and a time limit of 200 steps that is no ending."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [*sys.path, str(Path(__file__).parents[1] / "examples")])
        return importlib.import_module("own_task").PuckSettings().make()


class TestGymnax:
    """gymnax 1.0 ships no checker: what its `Environment` promises, one by one."""

    @pytest.fixture(autouse=True)
    def library(self):
        pytest.importorskip("gymnax")

    @pytest.mark.parametrize("name", ["rooms", "puck"])
    def test_it_keeps_to_the_contract_of_gymnax(self, name, request):
        from gymnax.environments import environment

        from pecjax.envs.as_gymnax import GymnaxEnvironment

        task, world = request.getfixturevalue(name)
        env = GymnaxEnvironment(task, world)
        params, number, steps = env.default_params, 6, 210 if name == "puck" else 45
        assert isinstance(env, environment.Environment) and isinstance(params, environment.EnvParams)
        assert env.name == type(task).__name__ and params.max_steps_in_episode == task.max_steps
        assert env.num_actions == (15 if name == "rooms" else 1)
        actions, observations = env.action_space(params), env.observation_space(params)
        keys = jax.random.split(jax.random.key(0), number)
        obs, state = jax.jit(jax.vmap(env.reset, (0, None)))(keys, params)

        def act(state, key):
            keys = jax.random.split(key, number)
            action = jax.vmap(actions.sample)(keys)
            out = jax.vmap(env.step, (0, 0, 0, None))(keys, state, action, params)
            return out[1], (actions.contains(action), *out)

        _, rows = jax.jit(lambda *args: jax.lax.scan(act, *args))(
            state, jax.random.split(jax.random.key(1), steps)
        )
        allowed, seen, states, reward, terminated, truncated, info = jax.device_get(rows)
        assert allowed.all()
        assert reward.shape == terminated.shape == truncated.shape == (steps, number)
        assert terminated.dtype == truncated.dtype == bool
        for shown in (obs, seen, info["final_observation"]):
            boxes = observations.spaces if name == "rooms" else {"": observations}
            parts = shown if name == "rooms" else {"": shown}
            assert set(boxes) == set(parts)
            for part, box in boxes.items():
                assert parts[part].shape[-len(box.shape) :] == box.shape and parts[part].dtype == box.dtype
                assert box.contains(parts[part])
        # What has ended begins anew within the step, and its last observation is kept.
        ended = terminated | truncated
        assert ended.sum() >= number and not (terminated & truncated).any()
        np.testing.assert_array_equal(states.time == 0, ended)
        some = "goal" if name == "rooms" else ""
        last, first = (
            np.asarray(shown[some] if some else shown) for shown in (info["final_observation"], seen)
        )
        same = (last == first).reshape(steps, number, -1).all(-1)
        np.testing.assert_array_equal(same, ~ended)
        assert set(info) >= {"success", *task.metrics, "terminated", "truncated"}

    def test_a_lower_limit_truncates_and_an_ending_goes_before_it(self, rooms, puck):
        from pecjax.envs.as_gymnax import GymnaxEnvironment

        env = GymnaxEnvironment(*puck)
        params, key = env.default_params.replace(max_steps_in_episode=3), jax.random.key(0)
        _, state = env.reset(key, params)
        ends = []
        for _ in range(4):
            _, state, _, terminated, truncated, _ = env.step(key, state, jnp.zeros(1), params)
            ends.append((bool(terminated), bool(truncated)))
        assert ends == [(False, False)] * 2 + [(False, True), (False, False)]
        env = GymnaxEnvironment(*rooms)  # whose own limit is an ending
        _, state = env.reset(key)
        for _ in range(20):
            _, state, _, terminated, truncated, info = env.step(key, state, 2, env.default_params)
        assert terminated and not truncated and info["timeout"] and not info["success"]

    def test_a_curriculum_draws_its_configurations(self, rooms):
        """Each episode starts where its row says."""
        from pecjax.curriculum.wrappers.gymnax import Curriculum, CurriculumParams
        from pecjax.envs.as_gymnax import GymnaxEnvironment

        bare = GymnaxEnvironment(*rooms)
        env, number = Curriculum(bare), num_configs(rooms[1].table)
        probabilities = jnp.where(jnp.arange(number) % 2 == 0, 1.0, 0.0)
        params = CurriculumParams(bare.table, probabilities)
        _, state = jax.jit(jax.vmap(env.reset, (0, None)))(jax.random.split(jax.random.key(0), 50), params)
        assert (state.config_id % 2 == 0).all() and len(set(state.config_id.tolist())) > 5
        start = take_configs(rooms[1].table, state.config_id).start
        np.testing.assert_array_equal(state.state.state.qpos[:, :2], start)
        rows = take_configs(bare.table, state.config_id)
        jax.tree.map(np.testing.assert_array_equal, state.state.state.config, rows.config)


class TestGymnasium:
    @pytest.fixture(autouse=True)
    def library(self):
        pytest.importorskip("gymnasium")

    @pytest.mark.parametrize("name", ["rooms", "puck"])
    def test_its_checker_has_nothing_to_say(self, name, request):
        """Warnings are errors here."""
        import gymnasium
        from gymnasium.utils.env_checker import check_env

        from pecjax.envs.as_gymnasium import GymnasiumEnvironment

        task, world = request.getfixturevalue(name)
        gymnasium.register(f"pecjax/{name}-v0", lambda: GymnasiumEnvironment(task, world))
        try:
            check_env(gymnasium.make(f"pecjax/{name}-v0").unwrapped)
        finally:
            gymnasium.registry.pop(f"pecjax/{name}-v0")

    def test_an_episode_is_that_of_the_task(self, puck):
        """The same actions from the same place, by the task alone."""
        from pecjax.envs.as_gymnasium import GymnasiumEnvironment

        task, world = puck
        env = GymnasiumEnvironment(task, world)
        obs, info = env.reset(seed=1, options={"config_id": 3})
        assert info == {"config_id": 3}
        row = take_configs(world.table, 3)
        state = {"place": jnp.float32(obs[0]), "speed": jnp.zeros(()), "steps": jnp.int32(0), "config": row}
        step, draw = jax.jit(task.step), np.random.default_rng(0)
        for n in range(1, 201):
            action = draw.uniform(-0.3, 0.3, 1).astype(np.float32)
            obs, reward, terminated, truncated, info = env.step(action)
            after = step(jax.random.key(0), state, action, world.params)
            state = after.state
            np.testing.assert_allclose(obs, task.observe(None, state, world.params), rtol=1e-5, atol=1e-6)
            np.testing.assert_allclose(reward, after.reward, rtol=1e-5)
            assert info["config_id"] == 3 and info["success"] == bool(after.success)
            np.testing.assert_allclose(info["effort"], after.metrics["effort"], rtol=1e-6)
            assert truncated == (n == 200) and not terminated

    def test_configurations_are_drawn_uniformly_unless_one_is_asked_for(self, puck):
        from scipy import stats

        from pecjax.envs.as_gymnasium import GymnasiumEnvironment

        env = GymnasiumEnvironment(*puck)
        env.reset(seed=0)
        ids = [env.reset()[1]["config_id"] for _ in range(400)]
        assert stats.chisquare(np.bincount(ids, minlength=20)).pvalue > 1e-3
        assert {type(n) for n in ids} == {int}

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"config_id": 20}, "config_id 20 does not exist; there are 0 to 19"),
            ({"row": 1}, "options has row"),
        ],
    )
    def test_options_that_cannot_be_meant_are_refused(self, puck, options, words):
        from pecjax.envs.as_gymnasium import GymnasiumEnvironment

        with pytest.raises(InputError, match=words):
            GymnasiumEnvironment(*puck).reset(options=options)
