"""Every sampler follows its published rule, over any history."""

import jax
import jax.numpy as jnp
import numpy as np
import plain_samplers as plain
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

from pecjax import InputError, curriculum as c
from pecjax.curriculum.posterior import beta_draws
from pecjax.curriculum.ranking import LOOKED_AT, best_share
from pecjax.curriculum.simplex import project
from pecjax.curriculum.thompson import AT_ONCE

N = 6
BATCH = 8  # rows; those that are not done stand in for episodes that go on

rows = st.tuples(
    st.integers(0, N - 1), st.booleans(), st.integers(1, 90), st.floats(-1, 3, width=16)
)  # id, failed, length, signal
histories = st.lists(st.lists(rows, max_size=BATCH), max_size=6)


def outcomes_of(batch):
    """A batch as outcomes of `BATCH` environments, so that all histories share a program."""
    padded = np.array([*batch, *[(0, 1, 7, 9.0)] * (BATCH - len(batch))], float)
    ids, failed, length, signal = padded.T
    done = np.arange(BATCH) < len(batch)
    return c.Outcomes(
        jnp.asarray(ids, jnp.int32), jnp.asarray(done), jnp.asarray(failed, bool),
        jnp.asarray(length, jnp.int32), jnp.asarray(plain.return_of(length, failed), jnp.float32),
        jnp.asarray(signal, jnp.float32),
    )  # fmt: skip


# (sampler, its rule in plain NumPy)
RULES = {
    "forgetting": (c.forgetting(N, 0.3, 4.0), lambda h: plain.forgetting(h, N, 0.3, 4.0)),
    "forgetting nothing": (c.forgetting(N, 0.2, np.inf), lambda h: plain.forgetting(h, N, 0.2, np.inf)),
    "failure_ema": (c.failure_ema(N, 3.0, 2.0), lambda h: plain.failure_ema(h, N, 3.0, 2.0)),
    "learnability": (c.learnability(N, 3.0), lambda h: plain.learnability(h, N, 3.0)),
    "pass_at_n": (c.pass_at_n(N, 8.0, 5.0), lambda h: plain.pass_at_n(h, N, 8.0, 5.0)),
    "pass at 2": (c.pass_at_n(N, 2.0, 5.0), lambda h: plain.pass_at_n(h, N, 2.0, 5.0)),
    "learning_progress": (
        c.learning_progress(N, 2.0, 9.0),
        lambda h: plain.learning_progress(h, N, 2.0, 9.0),
    ),
    "dro": (c.dro(N, 0.5, 0.1, 3.0), lambda h: plain.dro(h, N, 0.5, 0.1, 3.0)),
    "plr": (c.plr(N, 0.6, 0.3, 0.5, rank=True), lambda h: plain.plr(h, N, 0.6, 0.3, 0.5, rank=True)),
    "plr in proportion": (
        c.plr(N, 0.6, 0.3, 0.5, rank=False),
        lambda h: plain.plr(h, N, 0.6, 0.3, 0.5, rank=False),
    ),
    "plr, max_mc": (
        c.plr(N, 0.6, 0.3, 0.5, rank=False, score="max_mc"),
        lambda h: plain.plr(h, N, 0.6, 0.3, 0.5, False, lambda signal, best, solved: best - signal),
    ),
    "plr, solved_signal": (
        c.plr(N, 0.6, 0.3, 0.5, rank=False, score="solved_signal"),
        lambda h: plain.plr(h, N, 0.6, 0.3, 0.5, False, lambda signal, best, solved: signal * solved),
    ),
    "sfl": (c.sfl(N, 1.5, 2.0, 0.4, 0.5), lambda h: plain.sfl(h, N, 1.5, 2.0, 0.4, 0.5)),
    "per_step": (c.per_step(c.pec(N, 0.2)), lambda h: plain.per_step(h, N, 0.2)),
}


def after(sampler, history):
    update, state = jax.jit(sampler.update), sampler.init()
    for batch in history:
        state = update(state, outcomes_of(batch))
    return state


@pytest.mark.parametrize("name", RULES)
def test_probabilities_are_the_rule(name):
    sampler, rule = RULES[name]
    update, probabilities = jax.jit(sampler.update), jax.jit(sampler.probabilities)

    @settings(deadline=None, derandomize=True, max_examples=150)
    @given(histories)
    def check(history):
        state = sampler.init()
        for batch in history:
            state = update(state, outcomes_of(batch))
        np.testing.assert_allclose(probabilities(state), rule(history), rtol=2e-4, atol=2e-6)

    check()


def test_table_top_is_its_rule():
    """Scores of one value but for rounding may fall on either side of the threshold: none such are here."""
    sampler = c.table_top(N, 8.0, 5.0, 0.4, 0.75)
    draw, compared = np.random.default_rng(0), 0
    for _ in range(60):
        trials = [(int(draw.integers(N)), bool(draw.random() < 0.5), 5, 0.0) for _ in range(5 * BATCH)]
        history = [trials[at : at + BATCH] for at in range(0, len(trials), BATCH)]
        scores = [plain.u((s + 0.5) / (s + f + 1), 8.0) for s, f in plain.memories(history, N, 5.0)]
        if np.diff(np.sort(scores)).min() < 1e-5:
            continue
        compared += 1
        expected = plain.table_top(history, N, 8.0, 5.0, 0.4, 0.75)
        np.testing.assert_allclose(sampler.probabilities(after(sampler, history)), expected, rtol=1e-4)
    assert compared > 20


def test_forgetting_nothing_is_pec():
    history = [[(n, failed, 5, 0.0) for n, failed in zip((0, 1, 1, 3), (0, 1, 0, 1), strict=True)]] * 4
    ours, pec = c.forgetting(N, 0.2, np.inf), c.pec(N, 0.2)
    np.testing.assert_allclose(
        ours.probabilities(after(ours, history)), pec.probabilities(after(pec, history)), rtol=1e-6
    )


@settings(deadline=None, derandomize=True, max_examples=200)
@given(
    st.lists(st.sampled_from([0.0, 0.1, 0.25, 0.5, 2.0, 3.5]), min_size=1, max_size=40),
    st.floats(1 / 64, 1, width=32),
)
def test_the_best_share_is_that_of_sorting(scores, share):
    found = best_share(jnp.asarray(scores, jnp.float32), jnp.float32(share))
    expected = plain.top_of(np.float32(scores), share) / (share * len(scores))
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("share", [0.02, 0.1, 0.5])
def test_the_best_share_of_a_large_table_is_nearly_that_of_sorting(share):
    draw = np.random.default_rng(2)
    scores = draw.permutation(np.linspace(0, 1, 100_000)).astype(np.float32)
    found = np.asarray(best_share(jnp.asarray(scores), jnp.float32(share)))
    np.testing.assert_allclose(found.sum(), 1, rtol=1e-4)
    assert scores[found > 0].min() > scores[found == 0].max()
    assert abs((found > 0).mean() - share) < 4 * np.sqrt(share * (1 - share) / LOOKED_AT)
    # Equal scores fill up what is left, exactly: 30 % are 1, the others 0.
    found = best_share(jnp.asarray(scores > 0.7, jnp.float32), jnp.float32(share))
    expected = plain.top_of(scores > 0.7, share) / (share * len(scores))
    np.testing.assert_allclose(found, expected, rtol=1e-4)


@settings(deadline=None, derandomize=True, max_examples=200)
@given(st.lists(st.floats(-3, 3, width=32), min_size=1, max_size=40), st.floats(0, 1))
def test_the_projection_is_the_nearest_point_of_the_simplex(point, floor):
    floor = floor / len(point)
    found = project(jnp.asarray(point, jnp.float32), floor)
    np.testing.assert_allclose(found, plain.nearest_of_the_simplex(np.array(point), floor), atol=2e-6)


@pytest.mark.parametrize("a", [1.0, 1.5, 4.0, 30.0, 1000.0])
@pytest.mark.parametrize("b", [1.0, 2.0, 11.0, 500.0])
def test_beta_draws_are_nearly_those_of_the_posterior(a, b):
    found = beta_draws(jax.random.key(1), jnp.full(100_000, a), jnp.full(100_000, b))
    assert np.isfinite(found).all() and stats.kstest(np.float64(found), stats.beta(a, b).cdf).statistic < 0.02


def test_thompson_draws_from_the_posterior():
    """A thousand configurations of the same history: their hidden p are spread as the posterior is."""
    number, tries = 1000, 7
    sampler = c.thompson(number, np.inf)
    ids = np.tile(np.arange(number), tries)
    failed = np.repeat(np.arange(tries) < 2, number)
    state = sampler.update(sampler.init(), c.Outcomes(ids, True, failed))
    weight = np.float64(sampler.probabilities(state))
    posterior = stats.beta(tries - 2 + 1, 2 + 1)
    drawn = posterior.rvs(200_000, random_state=np.random.default_rng(0))
    assert stats.ks_2samp(0.25 * weight / weight.max(), drawn * (1 - drawn)).pvalue > 1e-3
    again = sampler.update(state, c.Outcomes(ids[:1], True, failed[:1]))
    assert np.corrcoef(weight, sampler.probabilities(again))[0, 1] < 0.2  # drawn anew
    same = sampler.update(sampler.init(), c.Outcomes(ids, True, failed))
    np.testing.assert_array_equal(weight, np.float64(sampler.probabilities(same)))


def test_thompson_draws_a_large_table_in_turns():
    number = 2 * AT_ONCE + 1000
    sampler = c.thompson(number)
    update, state = jax.jit(sampler.update), sampler.init()
    for turn in range(4):
        before = np.asarray(state.statistics.drawn)
        state = update(state, c.Outcomes(jnp.zeros(1, int), jnp.ones(1, bool), jnp.ones(1, bool)))
        changed = np.flatnonzero(before != state.statistics.drawn)
        begin = min(turn % 3 * AT_ONCE, number - AT_ONCE)
        assert changed[0] == begin and changed[-1] == begin + AT_ONCE - 1
        assert len(changed) > 0.99 * AT_ONCE
    assert (state.statistics.drawn != 0.5).mean() > 0.99


INFEASIBLE_AWARE = {
    "learnability": c.learnability,
    "pass_at_n": c.pass_at_n,
    "table_top": c.table_top,
    "thompson": c.thompson,
}


@pytest.mark.parametrize("name", INFEASIBLE_AWARE)
def test_what_always_fails_is_not_preferred(name):
    """At most twice its uniform share, beside configurations of every chance of success; PEC's is larger."""
    number, draw = 50, np.random.default_rng(3)
    chance = np.linspace(0, 1, number)  # of success; the first always fails
    shares = {}
    for kind, make in {name: INFEASIBLE_AWARE[name], "pec": c.pec}.items():
        sampler = make(number)
        update, state, kept = jax.jit(sampler.update), sampler.init(), []
        for _ in range(60):
            ids = draw.integers(0, number, 500)
            state = update(state, c.Outcomes(ids, np.ones(500, bool), draw.random(500) >= chance[ids]))
            kept.append(sampler.probabilities(state)[0] * number)
        shares[kind] = np.mean(kept[20:])
    assert shares[name] <= 2
    assert shares["pec"] > shares[name]


@pytest.mark.parametrize("epsilon", [0.0, 0.1, 1.0])
def test_a_floor_holds_exactly(epsilon):
    sampler = c.floor(c.dro(N, 5.0, 0.0), epsilon)
    history = [[(0, True, 5, 0.0)] + [(n, False, 5, 0.0) for n in range(1, N)]] * 30
    state = after(sampler, history)
    chances = np.float64(sampler.probabilities(state))
    inner = np.float64(c.dro(N, 5.0, 0.0).probabilities(state.sampler))
    np.testing.assert_allclose(chances, (1 - epsilon) * inner + epsilon / N, rtol=1e-6)
    assert chances.min() >= epsilon / N * (1 - 1e-6) and chances.max() > 0.8 * (1 - epsilon)
    drawn = np.bincount(sampler.sample(state, jax.random.key(0), 200_000), minlength=N)
    assert stats.chisquare(drawn, 200_000 * chances / chances.sum()).pvalue > 1e-3


def test_a_mixture_is_what_it_says():
    sampler = c.mixture({"a": c.pec(N), "b": c.learnability(N)}, 0.3)
    history = [[(n, n < 3, 5, 0.0) for n in range(5)]] * 4
    state = after(sampler, history)
    a, b = c.pec(N), c.learnability(N)
    expected = 0.3 * a.probabilities(after(a, history)) + 0.7 * b.probabilities(after(b, history))
    np.testing.assert_allclose(sampler.probabilities(state), expected, rtol=1e-6)
    drawn = np.bincount(sampler.sample(state, jax.random.key(0), 100_000), minlength=N)
    assert stats.chisquare(drawn, 100_000 * np.float64(expected) / np.float64(expected).sum()).pvalue > 1e-3
    with pytest.raises(InputError, match="3 samplers"):
        c.mixture(dict.fromkeys("abc", a))


def test_groups_learn_together():
    groups = np.array([2, 0, 0, 1, 2, 2])
    sampler, inner = c.by_group(c.pec(3, 0.2), groups), c.pec(3, 0.2)
    batch = [(0, True, 5, 0.0), (4, False, 5, 0.0), (1, True, 5, 0.0), (2, True, 5, 0.0)]
    of_groups = [(int(groups[n]), *rest) for n, *rest in batch]
    state, expected = after(sampler, [batch]), inner.probabilities(after(inner, [of_groups]))
    chances = sampler.probabilities(state)
    np.testing.assert_allclose(chances, (np.asarray(expected) / np.bincount(groups))[groups], rtol=1e-6)
    drawn = np.bincount(sampler.sample(state, jax.random.key(0), (50, 1000)).ravel(), minlength=N)
    assert stats.chisquare(drawn, 50_000 * np.float64(chances) / np.float64(chances).sum()).pvalue > 1e-3
    outside = jax.jit(sampler.update)(state, c.Outcomes(jnp.array([-1, N]), True, True))
    np.testing.assert_array_equal(outside.statistics, state.statistics)
    with pytest.raises(
        InputError, match=f"config_id {N} does not exist; the sampler has configurations 0 to 5"
    ):
        sampler.update(state, c.Outcomes([N], True, True))


@pytest.mark.parametrize(
    ("sampler", "groups", "words"),
    [
        (c.pec(2), [0, 2], "no configuration is in group 1"),
        (c.pec(2), [-1, 1], "-1 is no group"),
        (c.pec(2), [0.0, 1.0], "give .N,. integers"),
        (c.pec(3), [0, 1], "there are 2, and the sampler is over 3"),
    ],
)
def test_groups_that_cannot_be_are_refused(sampler, groups, words):
    with pytest.raises(InputError, match=words):
        c.by_group(sampler, groups)


def test_bins_of_columns_are_groups():
    wind, kind = np.array([0.0, 1, 2, 3, 4, 5, 6, 7]), np.array([0, 0, 0, 0, 1, 1, 1, 1])
    groups = c.bins([wind, kind], 4)
    assert sorted(set(groups)) == [*range(groups.max() + 1)]
    assert all(np.ptp(kind[groups == g]) == 0 and np.ptp(wind[groups == g]) <= 2 for g in set(groups))
    assert c.bins([np.zeros(5)], 3).tolist() == [0] * 5


@pytest.mark.parametrize(("values", "number"), [(4, 2), (5, 5), (8, 4), (10, 3), (1000, 7)])
def test_bins_of_different_values_have_equally_many_but_for_one(values, number):
    sizes = np.bincount(c.bins([np.arange(values)], number))
    assert len(sizes) == number and np.ptp(sizes) <= 1


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: c.forgetting(N, half_life=0.0), "half_life is 0.0; it must be a number above 0"),
        (lambda: c.failure_ema(N, power=-1.0), "power is -1.0; it must be a number 0 or more"),
        (lambda: c.table_top(N, best=1.5), "best is 1.5; it must be a number above 0, 1 at most"),
        (lambda: c.floor(c.pec(N), np.nan), "epsilon is nan; it must be a number from 0 to 1"),
        (lambda: c.failure_ema(N, np.inf), "half_life is inf; it must be a number above 0, and finite"),
        (lambda: c.failure_ema(N, power=np.inf), "power is inf; it must be a number 0 or more, and finite"),
        (lambda: c.dro(N, step=np.inf), "step is inf; it must be a number 0 or more, and finite"),
        (lambda: c.plr(N, score="max-mc"), "score is 'max-mc'; it is one of signal, max_mc, solved_signal"),
        (lambda: c.per_step(c.pec(N)).init(alpha=0.1), "no alpha; it has no number of its own"),
        (
            lambda: c.mixture({"a": c.pec(N), "b": c.pec(7)}),
            f"mixture: a is over {N} configurations, b over 7",
        ),
        (lambda: c.bins([], 3), "bins: no columns"),
        (lambda: c.bins([np.zeros(3), np.zeros(4)], 3), r"bins: columns have shapes \(3,\) and \(4,\)"),
        (lambda: c.bins([np.zeros(3)], 0), "bins: 0 bins; give 1 or more"),
        (lambda: c.learnability(N, jnp.ones(2)), r"half_life has shape \(2,\)"),
        (lambda: c.plr(100_001), "100001; by rank there may be 100000.*proportional"),
        (lambda: c.plr(N).update(c.plr(N).init(), c.Outcomes([0], True, True)), "signal is None"),
        (
            lambda: c.plr(N, score="max_mc").update(
                c.plr(N, score="max_mc").init(), c.Outcomes([0], True, True, signal=[0.0])
            ),
            "episode_return is None",
        ),
        (
            lambda: c.per_step(c.pec(N)).update(
                c.per_step(c.pec(N)).init(), c.Outcomes([0, 1], True, True, [1, 2, 3])
            ),
            "length .3,. does not broadcast",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(make, words):
    with pytest.raises(InputError, match=words) as error:
        make()
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "name",
    ["forgetting", "failure_ema", "learnability", "pass_at_n", "learning_progress", "plr", "thompson"],
)
def test_what_is_learned_of_a_few_of_many_is_what_is_learned_of_all(name):
    """Of a large table only what is in the batch is worked out; more ids than configurations ask for all."""
    number, draw = 50, np.random.default_rng(4)
    sampler = getattr(c, name)(number)
    few = many = sampler.init()
    for _ in range(4):
        ids, failed, done = draw.integers(0, number, 9), draw.random(9) < 0.5, draw.random(9) < 0.8
        signal = draw.random(9)
        few = sampler.update(few, c.Outcomes(ids, done, failed, signal=signal))
        *padded, signal = (np.append(part, np.zeros(number, int)) for part in (ids, done, failed, signal))
        many = sampler.update(many, c.Outcomes(*padded, signal=signal))
    learned = [state.statistics.memory if name == "thompson" else state for state in (few, many)]
    assert np.any(jax.tree.leaves(learned[0])[0])
    for one, other in zip(*map(jax.tree.leaves, learned), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)


def test_a_million_configurations_are_ranked_in_proportion_only():
    sampler = c.plr(1_000_000, rank=False)
    state = sampler.update(sampler.init(), c.Outcomes([5, 7], True, False, None, None, [1.0, 3.0]))
    chances = sampler.probabilities(state)
    np.testing.assert_allclose(chances.sum(), 1, rtol=1e-5)
    assert chances[7] > chances[5] > chances[0] > 0


@settings(deadline=None, derandomize=True, max_examples=100)
@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=N, max_size=N))
def test_diagnostics_are_those_of_scipy_and_of_hand(rows):
    trials, failures = np.array([(t, min(t, f)) for t, f in rows]).T
    chances = np.array([f + 1.0 if n % 2 else 0.0 for n, f in enumerate(failures)])
    chances /= chances.sum()
    found = c.diagnose(jnp.asarray(chances, jnp.float32), jnp.asarray([trials, failures]))
    expected = {
        "effective_configs": np.exp(stats.entropy(chances)),
        "least_probability": 0.0,
        "greatest_probability": chances.max() * N,
        "untried": np.mean(trials == 0),
        "never_solved": sum(p for p, t, f in zip(chances, trials, failures, strict=True) if t and t == f),
    }
    assert [*found] == [*expected]
    np.testing.assert_allclose([*found.values()], [*expected.values()], rtol=1e-5, atol=1e-7)
