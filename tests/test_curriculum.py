import subprocess
import sys

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies
from jax import numpy as jnp
from scipy import stats

from pecjax import InputError
from pecjax.curriculum import Outcomes, count_outcomes, pec, uniform

N = 20
ALPHAS = np.array([0, 0.1, 0.2, 0.3, 0.4], np.float32)
probabilities = jax.jit(pec(N).probabilities)  # α comes with the state


def state_of(trials, failures, alpha=0.2):
    counts = jnp.asarray(np.array([trials, failures]), jnp.int32)
    return pec(counts.shape[1]).init()._replace(statistics=counts, numbers={"alpha": jnp.float32(alpha)})


def equations_1_and_2(trials, failures, alpha):
    priority = [f / t + alpha if t > 0 else 1.0 for t, f in zip(trials, failures, strict=True)]
    return np.array(priority) / sum(priority)


def counts_of(rng, high=200):
    trials = rng.integers(0, high, N)
    return trials, rng.integers(0, trials + 1)


def some_outcomes(shape, seed=0):
    rng = np.random.default_rng(seed)
    return Outcomes(
        jnp.asarray(rng.integers(0, N, shape), jnp.int32),
        jnp.asarray(rng.random(shape) < 0.4),
        jnp.asarray(rng.random(shape) < 0.5),  # also where nothing is done: that must not count
    )


def counted_by_hand(outcomes):
    counts = np.zeros((2, N), int)
    for config, done, failed in zip(*(np.ravel(x) for x in outcomes[:3]), strict=True):
        if done:
            counts[0, config] += 1
            counts[1, config] += bool(failed)
    return counts


trials_and_failures = strategies.lists(
    strategies.integers(0, 10**6).flatmap(
        lambda trials: strategies.tuples(strategies.just(trials), strategies.integers(0, trials))
    ),
    min_size=N,
    max_size=N,
)


@settings(deadline=None, derandomize=True, max_examples=200)
@given(trials_and_failures, strategies.floats(2**-10, 10, width=32))
def test_probabilities_are_equations_1_and_2(counts, alpha):
    trials, failures = np.array(counts).T
    actual = np.asarray(probabilities(state_of(trials, failures, alpha)))
    np.testing.assert_allclose(actual, equations_1_and_2(trials, failures, alpha), rtol=1e-5)
    np.testing.assert_allclose(actual.sum(), 1, rtol=1e-5)
    # Priorities of tried ones lie in [α, 1 + α], which bounds how unlike two of them can be.
    tried = actual[trials > 0]
    if len(tried):
        assert tried.max() / tried.min() <= (1 + alpha) / alpha * (1 + 1e-5)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(trials_and_failures, strategies.integers(0, N - 1))
def test_a_further_failure_makes_a_configuration_likelier(counts, config):
    trials, failures = np.array(counts).T
    if trials[config] == 0 or failures[config] == trials[config]:
        trials[config], failures[config] = 2, 1
    before = probabilities(state_of(trials, failures))
    failures[config] = trials[config]
    after = probabilities(state_of(trials, failures))
    assert after[config] > before[config]
    assert np.all(np.delete(after, config) <= np.delete(before, config))


def test_before_any_trial_all_are_alike():
    state = pec(N).init()
    np.testing.assert_allclose(probabilities(state), np.full(N, 1 / N), rtol=1e-6)
    assert state.statistics.shape == (2, N)
    assert state.numbers == {"alpha": np.float32(0.2)}  # the paper's default


def test_with_alpha_0_and_everything_solved_all_are_alike():
    np.testing.assert_allclose(probabilities(state_of([5] * N, [0] * N, 0.0)), np.full(N, 1 / N), rtol=1e-6)
    # What is not tried yet is still of priority 1, and all that is left.
    np.testing.assert_allclose(
        probabilities(state_of([0] + [5] * (N - 1), [0] * N, 0.0)), np.eye(N)[0], rtol=1e-6
    )


@pytest.mark.parametrize("alpha", [0.0, 0.2])
def test_draws_follow_the_probabilities(alpha):
    trials, failures = counts_of(np.random.default_rng(1))
    trials[0], failures[1:3] = 0, 0
    state = state_of(trials, failures, alpha)
    ids = jax.jit(pec(N).sample, static_argnums=2)(state, jax.random.key(0), (200, 500))
    assert ids.shape == (200, 500) and ids.dtype == jnp.int32
    drawn, expected = np.bincount(np.ravel(ids), minlength=N), equations_1_and_2(trials, failures, alpha)
    possible = expected > 0
    assert not drawn[~possible].any()
    assert stats.chisquare(drawn[possible], 100_000 * expected[possible]).pvalue > 1e-3


def test_uniform_draws_all_alike_and_keeps_counts_that_change_nothing():
    sampler = uniform(N)
    state = sampler.init()
    np.testing.assert_allclose(sampler.probabilities(state), np.full(N, 1 / N))
    ids = jax.jit(sampler.sample, static_argnums=2)(state, jax.random.key(0), (100_000,))
    assert ids.dtype == jnp.int32
    assert stats.chisquare(np.bincount(ids, minlength=N)).pvalue > 1e-3
    outcomes = some_outcomes((100,))
    after = sampler.update(sampler.update(state, outcomes), outcomes)
    np.testing.assert_array_equal(after.statistics, 2 * counted_by_hand(outcomes))
    np.testing.assert_array_equal(sampler.probabilities(after), sampler.probabilities(state))


@pytest.mark.parametrize("shape", [(), (1,), (64,), (128, 32), (2, 3, 50)])
def test_what_is_done_is_counted(shape):
    outcomes = some_outcomes(shape)
    np.testing.assert_array_equal(count_outcomes(outcomes, N), counted_by_hand(outcomes))


@pytest.mark.parametrize("traced", [False, True])
def test_ids_of_environments_serve_flags_of_their_steps(traced):
    ids, flags = some_outcomes((8,)).config_id, some_outcomes((30, 8), seed=1)
    count = jax.jit(count_outcomes, static_argnums=1) if traced else count_outcomes
    counts = count(Outcomes(ids, flags.done, flags.failed), N)
    whole = Outcomes(np.broadcast_to(ids, (30, 8)), flags.done, flags.failed)
    np.testing.assert_array_equal(counts, counted_by_hand(whole))


@pytest.mark.parametrize(
    ("outcomes", "trials", "failures"),
    [
        (Outcomes([3, 3, 5], [True, True, False], [True, False, True]), {3: 2}, {3: 1}),
        (Outcomes(7, True, False), {7: 1}, {}),
        (Outcomes(np.int64(7), 1, 1.0), {7: 1}, {7: 1}),
        (Outcomes([1, 2], 1, [0, 1]), {1: 1, 2: 1}, {2: 1}),
        (Outcomes([-1, 2], [0, 1], [np.nan, 1]), {2: 1}, {2: 1}),  # what is not done may hold anything
    ],
)
def test_lists_and_scalars_are_outcomes_too(outcomes, trials, failures):
    counts = np.asarray(pec(N).update(pec(N).init(), outcomes).statistics)
    expected = np.zeros((2, N), int)
    for row, numbers in enumerate((trials, failures)):
        for config, number in numbers.items():
            expected[row, config] = number
    np.testing.assert_array_equal(counts, expected)


@pytest.mark.parametrize(
    ("outcomes", "words"),
    [
        (Outcomes([3, N], [1, 1], [0, 0]), f"config_id {N} does not exist; .* 0 to {N - 1}"),
        (Outcomes(jnp.array([-1]), jnp.array([True]), jnp.array([True])), "config_id -1 does not exist"),
        (Outcomes([3], [1], [-1.0]), "failed is -1.0"),
        (Outcomes([3], [1], jnp.array([0.5])), "failed is 0.5"),
        (Outcomes([3], [1], [np.nan]), "failed is nan"),
        (Outcomes([3], [2], [0]), "done is 2"),
        (Outcomes([3.0], [1], [0]), "config_id is of type float64; give integers"),
        (
            Outcomes([1, 2, 3], [1, 1], [0, 0]),
            r"config_id \(3,\), done \(2,\), failed \(2,\) do not broadcast",
        ),
    ],
)
def test_outcomes_that_cannot_be_meant_are_refused(outcomes, words):
    with pytest.raises(InputError, match=words):
        count_outcomes(outcomes, N)


def test_where_values_are_traced_ids_out_of_range_are_dropped():
    counts = jax.jit(count_outcomes, static_argnums=1)(Outcomes(jnp.array([-1, 3, N]), True, True), N)
    np.testing.assert_array_equal(counts, np.eye(N, dtype=int)[[3, 3]])


def test_flags_may_be_floats_and_duplicates_add_up():
    ids = jnp.array([3, 3, 3, 3, 7, 7])
    counts = count_outcomes(
        Outcomes(ids, jnp.array([1.0, 1, 1, 0, 1, 0]), jnp.array([1.0, 1, 0, 1, 0, 1])), N
    )
    assert counts.dtype == jnp.int32
    assert counts[:, 3].tolist() == [3, 2] and counts[:, 7].tolist() == [1, 0]
    assert counts.sum() == 6


def test_counts_are_kept_over_the_whole_training():
    sampler = pec(N)
    update, state = jax.jit(sampler.update), sampler.init()
    batches = [some_outcomes((40, 8), seed) for seed in range(5)]
    for batch in batches:
        state = update(state, batch)
    np.testing.assert_array_equal(state.statistics, sum(counted_by_hand(batch) for batch in batches))
    expected = equations_1_and_2(*np.asarray(state.statistics), 0.2)
    np.testing.assert_allclose(probabilities(state), expected, rtol=1e-5)


def test_a_study_over_alpha_is_a_vmap():
    outcomes = some_outcomes((500,))

    def study(alpha):
        sampler = pec(N, alpha)
        state = sampler.update(sampler.init(), outcomes)
        return state, sampler.probabilities(state), sampler.sample(state, jax.random.key(0), (50,))

    together = jax.jit(jax.vmap(study))(jnp.asarray(ALPHAS))
    separate = [study(float(alpha)) for alpha in ALPHAS]
    for n, (state, chances, ids) in enumerate(separate):
        np.testing.assert_array_equal(together[0].statistics[n], state.statistics)
        np.testing.assert_allclose(together[1][n], chances, rtol=1e-6)
        np.testing.assert_array_equal(together[2][n], ids)
    spread = [np.ptp(chances) for _, chances, _ in separate]
    assert spread == sorted(spread, reverse=True)  # α levels the failure ratios out


IMPORT = """
import sys
import jax, numpy
before = set(sys.modules)
import pecjax.curriculum
print(*sorted({name.split(".")[0] for name in set(sys.modules) - before} - set(sys.stdlib_module_names)))
"""


def test_the_samplers_alone_load_jax_and_numpy_only():
    found = subprocess.run(
        [sys.executable, "-c", IMPORT], capture_output=True, text=True, check=True, timeout=120
    )
    assert found.stdout.split() == ["pecjax"]


@pytest.mark.parametrize("alpha", [-0.1, float("nan"), float("inf"), -float("inf")])
def test_a_bad_alpha_is_refused(alpha):
    with pytest.raises(InputError, match="alpha is"):
        pec(N, alpha)
