"""Draws from large tables against the distribution that they should follow, and what they compile to."""

import re

import jax
import numpy as np
import pytest
from jax import numpy as jnp
from scipy import stats

from pecjax.curriculum import pec, sample_ids, uniform
from pecjax.curriculum.draws import MAX_AT_ONCE, normalized

MILLION = 10**6


def rare_failures(size=MILLION, alpha=0.001, failing=0.01):
    """PEC's state where every configuration was tried once and a few failed, and what each is worth."""
    failed = np.random.default_rng(0).random(size) < failing
    counts = jnp.asarray(np.stack([np.ones(size), failed]), jnp.int32)
    priority = failed + alpha
    return pec(size, alpha).init()._replace(statistics=counts), priority / priority.sum()


def counts_of_draws(sampler, state, batches, batch=2**18):
    """How often each configuration is drawn; one program for every batch."""

    @jax.jit
    def draw(counts, key):
        return counts.at[sampler.sample(state, key, batch)].add(1), None

    size = sampler.probabilities(state).shape[0]
    keys = jax.random.split(jax.random.key(7), batches)
    counts = jnp.zeros(size, jnp.int32)
    for key in keys:
        counts, _ = draw(counts, key)
    return np.asarray(counts)


@pytest.fixture(scope="module")
def million():
    """(counts of 20 million draws by PEC, probabilities) of a million configurations."""
    state, expected = rare_failures()
    return counts_of_draws(pec(MILLION), state, batches=77), expected


@pytest.mark.slow
def test_a_million_configurations_are_drawn_as_often_as_they_should_be(million):
    counts, expected = million
    draws = counts.sum()
    assert draws == 77 * 2**18 > 2e7
    # The least probable ones come to about two draws each. Blocks of ten thousand, and within them
    # the rare and the frequent apart.
    rare = expected < expected.mean()
    for chosen in (rare, ~rare, np.ones(MILLION, bool)):
        found, wanted = (
            np.add.reduceat(np.where(chosen, of, 0), np.arange(0, MILLION, 10_000))
            for of in (counts, draws * expected)
        )
        assert stats.chisquare(found, wanted * found.sum() / wanted.sum()).pvalue > 1e-3
    assert stats.chisquare([counts[rare].sum(), counts[~rare].sum()], draws * np.array(
        [expected[rare].sum(), expected[~rare].sum()])).pvalue > 1e-3  # fmt: skip
    # The largest of a hundred standard normal numbers is beyond 4.5 once in 1,500 times.
    blocks = counts.reshape(100, -1).sum(axis=1)
    wanted = draws * expected.reshape(100, -1).sum(axis=1)
    assert np.abs((blocks - wanted) / np.sqrt(wanted)).max() < 4.5


@pytest.mark.slow
def test_none_of_a_million_configurations_is_out_of_reach(million):
    counts, expected = million
    rare = expected < expected.mean()
    mean = counts.sum() * expected[rare][0]
    assert 1 < mean < 3
    # How many are drawn 0, 1, 2, … times is Poisson's.
    times = np.bincount(counts[rare], minlength=12)
    times = np.append(times[:10], times[10:].sum())
    wanted = stats.poisson(mean).pmf(np.arange(10))
    wanted = rare.sum() * np.append(wanted, 1 - wanted.sum())
    assert stats.chisquare(times, wanted).pvalue > 1e-3
    # Whoever is not drawn lies anywhere: near the end of a block as well as at its beginning.
    place = np.arange(MILLION)[rare & (counts == 0)] % 32
    at_all = np.bincount(np.arange(MILLION)[rare] % 32)
    assert stats.chisquare(np.bincount(place, minlength=32), at_all * place.size / at_all.sum()).pvalue > 1e-3


@pytest.mark.parametrize("size", [1, 2, MAX_AT_ONCE, MAX_AT_ONCE + 1, 33_000])
def test_every_size_is_drawn_in_proportion_and_nothing_of_no_mass(size):
    mass = np.random.default_rng(size).random(size).astype(np.float32)
    mass[np.random.default_rng(1).random(size) < 0.3] = 0
    mass[0] = 0.5
    ids = np.asarray(jax.jit(sample_ids, static_argnums=2)(jnp.asarray(mass), jax.random.key(0), 10**6))
    assert ids.dtype == np.int32 and ids.min() >= 0 and ids.max() < size
    counts = np.bincount(ids, minlength=size)
    assert counts[mass == 0].sum() == 0
    likely = mass.astype(float) / mass.astype(float).sum()
    if size > 1:
        assert stats.chisquare(counts[mass > 0], 1e6 * likely[mass > 0]).pvalue > 1e-3


@pytest.mark.parametrize("size", [1, 2, 24, 1000, MAX_AT_ONCE])
def test_small_tables_are_drawn_as_jax_draws_them(size):
    """To the bit: the paper's sets have the draws that they always had."""
    mass = np.float32(np.random.default_rng(size).random(size))
    mass[size // 2 : size // 2 + size // 10] = 0.0
    wanted = jax.random.choice(jax.random.key(3), size, (700, 5), p=normalized(jnp.asarray(mass)))
    np.testing.assert_array_equal(sample_ids(jnp.asarray(mass), jax.random.key(3), (700, 5)), wanted)


@pytest.mark.parametrize(
    ("shape", "wanted"), [((), ()), (5, (5,)), ((5,), (5,)), ([2, 3], (2, 3)), (0, (0,))]
)
@pytest.mark.parametrize("size", [20, 5000])
@pytest.mark.parametrize("make", [pec, uniform])
def test_shapes(make, size, shape, wanted):
    sampler = make(size)
    drawn = jax.eval_shape(lambda key: sampler.sample(sampler.init(), key, shape), jax.random.key(0))
    assert drawn.shape == wanted and drawn.dtype == np.int32


def test_draws_of_one_table_are_independent():
    mass = jnp.ones(4096)
    ids = np.asarray(sample_ids(mass, jax.random.key(0), (2, 200_000)))
    for one, other in (
        (ids[0], ids[1]),
        (ids[0] // 32, ids[0] % 32),
        (ids[:, 1:] // 512, ids[:, :-1] // 512),
    ):
        pairs = np.histogram2d(np.ravel(one), np.ravel(other), bins=8)[0]
        assert stats.chi2_contingency(pairs).pvalue > 1e-3


@pytest.mark.parametrize("make", [pec, uniform])
def test_a_large_table_is_no_constant_of_the_program(make):
    """Else XLA sums it up while it compiles, which takes seconds for a million configurations."""
    size = 100_000
    sampler = make(size)
    draw = jax.jit(lambda state, key: sampler.sample(state, key, (32, 64)))
    program = draw.lower(sampler.init(), jax.random.key(0)).compile()
    shapes = re.findall(r"f32\[([\d,]+)\]\S* constant\(", program.as_text())
    assert max((np.prod([int(n) for n in shape.split(",")]) for shape in shapes), default=0) < 2000
    # And nothing is made for every configuration and draw.
    assert program.memory_analysis().temp_size_in_bytes < 4 * size * 64
