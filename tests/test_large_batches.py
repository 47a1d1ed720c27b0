"""As many environments as a GPU would fly: what their program would take and call, without running it."""

import re

import jax
import pytest

from pecjax.agents import AXIS, PPO, device_mesh, shard
from pecjax.curriculum import pec
from pecjax.envs.rooms import Rooms
from pecjax.envs.task import num_configs
from pecjax.training.build import everywhere


@pytest.mark.slow
@pytest.mark.parametrize("devices", [1, 4])
def test_65536_environments_fit_a_gpu_and_stay_on_it(devices):
    task, world = Rooms().make()
    settings = PPO(num_envs=65_536, num_steps=16, num_minibatches=8)
    mesh = device_mesh(devices)
    agent = shard(settings.make(task, pec(num_configs(world.table)), AXIS), mesh)
    state = jax.eval_shape(agent.init, jax.random.key(0), world)
    compiled = jax.jit(agent.iterate, donate_argnums=0).lower(state, everywhere(world, mesh)).compile()
    held = compiled.memory_analysis()
    taken = held.temp_size_in_bytes + held.argument_size_in_bytes
    assert 1e8 < devices * taken < 8e9  # a step's features alone take 0.2 kB
    text = compiled.as_text()
    for word in ("infeed", "outfeed", "callback", "host"):
        assert not re.search(rf"= \S+ {word}|custom_call_target=\"[^\"]*{word}", text), word
    assert "all-reduce" in text
    # Nothing but sums of what is small passes between devices: no environment is gathered.
    assert not re.search(r"= \S+ (all-gather|all-to-all|collective-permute)", text)
