"""Programs: what the host's loop runs, for one run over all devices or for several side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec

from pecjax.agents import AXIS, Metrics, TrainState, device_mesh
from pecjax.envs.task import EvalSet, Task, World, num_configs
from pecjax.runtime.devices import check_memory, choose_num_devices, compiler_options
from pecjax.training.build import Run, abstract_state, check_training_memory, observation_bytes, on_devices
from pecjax.training.contracts import check_contracts
from pecjax.training.evaluation import make_episode_runner, make_evaluator, stratified_config_ids
from pecjax.training.run_episodes import SIDE_BY_SIDE, EvalResult
from pecjax.training.settings import RunSettings

RECORDED_BYTES = 32  # of a step: a pose and an action
Iterate = Callable[[TrainState], tuple[TrainState, Metrics]]


class Program(NamedTuple):
    """K runs; metrics, results, counts and probabilities have a leading axis of K, or more that is no run's.

    Attributes:
        num_runs: K.
        eval_set: what `evaluate` flies in.
        steps_per_iteration: environment steps of each run.
        iterate: (state) -> (state, metrics); it takes the place of the state it is given.
        evaluate: (state) -> EvalResult; compiled when it is first called.
        counts: (state) -> (K, 3, N), trials, failures and steps since the beginning.
        probabilities: (state) -> (K, N), what the samplers draw by.
    """

    num_runs: int
    eval_set: EvalSet
    steps_per_iteration: int
    iterate: Iterate
    evaluate: Callable[[TrainState], EvalResult]
    counts: Callable[[TrainState], np.ndarray]
    probabilities: Callable[[TrainState], np.ndarray]


def one_run(
    run: Run,
    settings: RunSettings,
    iterate: Iterate,
    compiling: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> Program:
    """The program of one run, whose environments are spread over the run's mesh.

    Args:
        iterate: of `compile_iteration`.
        compiling: entered while the evaluation is compiled.
    """
    compiled: list[Callable[[Any, World], EvalResult]] = []

    def evaluate(state: TrainState) -> EvalResult:
        if not compiled:
            with compiling():
                compiled.append(compile_evaluator(run, settings, state.learner))
        return _leading(compiled[0](state.learner, run.eval_world))

    def with_axis(state: TrainState) -> tuple[TrainState, Metrics]:
        state, metrics = iterate(state)
        return state, _leading(jax.device_get(metrics))

    probabilities = jax.jit(run.sampler.probabilities)
    return Program(
        1,
        run.eval_set,
        run.agent.steps_per_iteration,
        with_axis,
        evaluate,
        lambda state: np.asarray(state.counts)[None],
        lambda state: np.asarray(probabilities(state.sampler))[None],
    )


def _leading(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: np.asarray(leaf)[None], tree)


def start(run: Run, seed: int) -> tuple[TrainState, Iterate]:
    """The first state and the compiled iteration, the one prepared while the other compiles."""
    lowered = _lower_iteration(run)
    with ThreadPoolExecutor(1) as aside:
        iterate = aside.submit(lambda: _compiled(lowered, run))
        init = jax.jit(run.agent.init, compiler_options=compiler_options(runs_once=True))
        return init(jax.random.key(seed), run.world), iterate.result()


def compile_iteration(run: Run) -> Iterate:
    """The iteration as a compiled program; it takes the place of the state it is given."""
    return _compiled(_lower_iteration(run), run)


def _lower_iteration(run: Run) -> jax.stages.Lowered:
    program = jax.jit(run.agent.iterate, donate_argnums=0, compiler_options=compiler_options())
    return program.lower(abstract_state(run), run.world)


def _compiled(lowered: jax.stages.Lowered, run: Run) -> Iterate:
    compiled = lowered.compile()
    return lambda state: compiled(state, run.world)


def compile_evaluator(run: Run, settings: RunSettings, learner: Any) -> Callable[[Any, World], EvalResult]:
    """The run's evaluation as a compiled program, (learner, world) -> EvalResult.

    Raises:
        InputError: more episodes than memory holds the observations or the recordings of.
    """
    about, devices = settings.evaluation, run.mesh.devices.size
    fewer = "take fewer --evaluation.episodes"
    seen = observation_bytes(run.task, min(about.episodes, SIDE_BY_SIDE * devices))
    check_memory(seen, devices, "the observations of an evaluation", f"{fewer}, or smaller images")
    if type(run.task).pose is not Task.pose:  # else nothing is recorded
        recorded = RECORDED_BYTES * (run.task.max_steps + 1) * about.episodes
        check_memory(recorded, devices, "the recordings of an evaluation", fewer)
    return make_evaluator(
        run.task, run.agent, run.mesh, episodes=about.episodes, greedy=about.greedy, seed=about.seed
    )(learner, run.eval_world)


class StudyProgram(NamedTuple):
    """A program of K runs before it starts.

    Attributes:
        init: (seeds, numbers of the sampler by name) -> their first state; of fewer than K the last is
            repeated.
        program: the rest.
        elsewhere: whether policies are evaluated in another table than they are trained in.
    """

    init: Callable[[Sequence[int], Mapping[str, Sequence[float]]], TrainState]
    program: Program
    elsewhere: bool


def several_runs(settings: RunSettings, task: Task, world: World, runs: int) -> StudyProgram:
    """The program that trains so many runs, which differ in seed and in numbers of their sampler.

    Every device has whole runs to itself, so devices never wait for one another within an
    iteration. A run is the same to the last digit beside any others, though not in a program of another
    number of runs: XLA may then round elsewhere.

    Raises:
        InputError: settings that do not fit one another, or more than memory can hold.
    """
    devices = choose_num_devices(None, runs)
    mesh = device_mesh(devices)
    sampler = settings.sampler.make(num_configs(world.table))
    check_contracts(settings, task, world, sampler)
    agent = settings.agent.make(task, sampler)
    check_training_memory(settings, task, agent, devices, runs)
    eval_set, about = settings.task.eval_set(world), settings.evaluation
    run = make_episode_runner(task, agent, greedy=about.greedy, seed=about.seed)
    world, eval_world = on_devices(world, eval_set, mesh)
    config_id = stratified_config_ids(num_configs(eval_set.table), about.episodes, about.seed)

    def init(world: World, seed: jax.Array, numbers: dict[str, jax.Array]) -> TrainState:
        return agent.init(jax.random.key(seed), world, numbers)

    def iterate(world: World, state: TrainState) -> tuple[TrainState, Metrics]:
        return agent.iterate(state, world)

    def evaluate(world: World, learner: Any) -> EvalResult:
        result = run(learner, world, jnp.asarray(config_id), jnp.arange(config_id.size))
        return result._replace(poses=None, actions=None)

    def spread(one: Callable, **options: Any) -> Callable:
        """`one` for each run, the world being the same for all."""
        spec = PartitionSpec(AXIS)

        def many(world: World, *of_runs: Any) -> Any:
            return jax.vmap(lambda *of_run: one(world, *of_run))(*of_runs)

        def sharded(world: World, *of_runs: Any) -> Any:
            specs = (PartitionSpec(), *[spec] * len(of_runs))
            return jax.shard_map(many, mesh=mesh, in_specs=specs, out_specs=spec, check_vma=False)(
                world, *of_runs
            )

        return jax.jit(sharded, compiler_options=compiler_options(runs_once=one is init), **options)

    def filled(values: Sequence[float], dtype: Any) -> np.ndarray:
        return np.pad(np.asarray(values, dtype), (0, runs - len(values)), mode="edge")

    probabilities = jax.jit(jax.vmap(sampler.probabilities))
    # The numbers are in the sampler's state, so one `iterate` serves all.
    iterate_all, evaluate_all, init_all = spread(iterate, donate_argnums=1), spread(evaluate), spread(init)
    return StudyProgram(
        lambda seeds, numbers: init_all(
            world,
            filled(seeds, np.int32),
            {name: filled(v, np.float32) for name, v in numbers.items()},
        ),
        Program(
            runs,
            eval_set,
            agent.steps_per_iteration,
            lambda state: iterate_all(world, state),
            lambda state: jax.device_get(evaluate_all(eval_world, state.learner)),
            lambda state: np.asarray(state.counts),
            lambda state: np.asarray(probabilities(state.sampler)),
        ),
        eval_world is not world,
    )
