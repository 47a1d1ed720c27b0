"""Distributions over actions against scipy, numerical integration, and how often what is drawn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, special, stats

from pecjax import InputError
from pecjax.agents.distributions import MIN_SCALE, categorical, make_distribution, tanh_normal
from pecjax.envs.spaces import Box, Discrete


def some_logits(*shape, seed=1):
    return np.random.default_rng(seed).normal(0, 2, shape)


def test_an_action_is_the_distribution_function_inverted():
    draw = np.random.default_rng(1)
    logits, chance = draw.normal(size=(500, 15)), draw.uniform(size=500)
    weights = np.exp(logits)
    reached = np.cumsum(weights, axis=1) / weights.sum(axis=1, keepdims=True)
    expected = [np.searchsorted(row, at, side="right") for row, at in zip(reached, chance, strict=True)]
    drawn = categorical(15).draw(jnp.float32(logits), jnp.float32(chance))
    np.testing.assert_array_equal(drawn, expected)
    assert drawn.dtype == jnp.int32
    np.testing.assert_array_equal(categorical(15).action(drawn), drawn)


def test_drawn_actions_are_as_frequent_as_they_are_likely():
    logits, of = jnp.array([0.0, 3.0, -jnp.inf, 1.0]), categorical(4)
    noise = jax.vmap(of.noise)(jax.random.split(jax.random.key(0), 10**5))
    drawn = jax.jit(of.draw)(jnp.tile(logits, (10**5, 1)), noise)
    found, likely = np.bincount(drawn, minlength=4), special.softmax(np.float64(logits))
    assert found[2] == 0
    assert stats.chisquare(found[likely > 0], 1e5 * likely[likely > 0]).pvalue > 1e-3


def test_an_action_is_never_one_too_many():
    # In float32 these 15 equal likelihoods may add up to less than the greatest chance.
    greatest = np.nextafter(np.float32(1), np.float32(0))
    assert categorical(15).draw(jnp.zeros(15), jnp.asarray(greatest)) == 14


@pytest.mark.parametrize("batch", [(), (7,), (3, 5)])
def test_a_categorical_distribution_equals_scipy(batch):
    old, new = some_logits(*batch, 6), some_logits(*batch, 6, seed=2)
    of, (p, q) = categorical(6), (special.softmax(x, axis=-1) for x in (old, new))
    every = [of.log_prob(jnp.float32(old), jnp.full(batch, a, jnp.int32)) for a in range(6)]
    np.testing.assert_allclose(np.stack(every, axis=-1), special.log_softmax(old, axis=-1), rtol=1e-5)
    np.testing.assert_allclose(np.exp(every).sum(axis=0), 1, rtol=1e-5)
    np.testing.assert_allclose(
        of.kl(jnp.float32(old), jnp.float32(new)), stats.entropy(p, q, axis=-1), rtol=1e-4, atol=1e-6
    )
    anything = jnp.zeros(batch, jnp.int32)
    found = of.entropy(jnp.float32(new), jnp.float32(old), anything)
    np.testing.assert_allclose(found, stats.entropy(q, axis=-1), rtol=1e-5)
    mode = of.mode(jnp.float32(old))
    np.testing.assert_array_equal(mode, old.argmax(axis=-1))
    assert mode.dtype == jnp.int32 and of.num_params == 6


BOXES = [Box((1,), -1.0, 1.0), Box((1,), -2.0, 2.0), Box((1,), 0.5, 4.5)]
NORMALS = [(0.3, 0.5), (-1.5, 0.8), (0.0, 2.5)]  # mean and scale, before they are squashed


def parameters(means, scales):
    """What the network would have to put out."""
    raw = np.log(np.expm1(np.asarray(scales, float) - MIN_SCALE))  # softplus inverted
    return jnp.float32(np.concatenate([np.atleast_1d(means), np.atleast_1d(raw)], axis=-1))


def squashed(box, drawn):
    return box.low + (box.high - box.low) / 2 * (np.tanh(drawn) + 1)


def density(box, mean, scale):
    """Of an action, by the change of variables, in float64."""
    half = (box.high - box.low) / 2

    def of_action(action):
        y = (action - box.low) / half - 1
        return stats.norm.pdf(np.arctanh(y), mean, scale) / (half * (1 - y**2))

    return of_action


def integral(box, function):
    """Over the actions, their bounds left out by a hair."""
    edge = 1e-12 * (box.high - box.low)
    return integrate.quad(function, box.low + edge, box.high - edge, limit=1000)[0]


each_box = pytest.mark.parametrize("box", BOXES, ids=str)
each_normal = pytest.mark.parametrize(("mean", "scale"), NORMALS)


@each_box
@each_normal
def test_the_density_of_a_squashed_action_is_scipys_and_integrates_to_one(box, mean, scale):
    of, params = tanh_normal(box), parameters(mean, scale)
    drawn = jnp.linspace(mean - 5 * scale, mean + 5 * scale, 20_001)[:, None]
    log_prob, action = np.float64(of.log_prob(params, drawn)), np.float64(of.action(drawn))[:, 0]
    assert integral(box, density(box, mean, scale)) == pytest.approx(1, abs=1e-6)
    # float32 tells actions near a bound no longer apart, and there alone.
    inside = np.abs(np.asarray(drawn)[:, 0]) < 3
    np.testing.assert_allclose(
        np.exp(log_prob[inside]), density(box, mean, scale)(action[inside]), rtol=1e-3, atol=1e-6
    )
    exact = squashed(box, np.float64(drawn[:, 0]))
    np.testing.assert_allclose(action, exact, rtol=1e-6, atol=1e-6)
    assert np.trapezoid(np.exp(log_prob), exact) == pytest.approx(1, abs=1e-4)


def test_several_actions_are_independent():
    box = Box((2,), -2.0, 2.0)
    of, params = tanh_normal(box), parameters([0.3, -1.0], [0.5, 1.2])
    drawn = jnp.asarray(np.random.default_rng(0).normal(size=(4, 6, 2)), jnp.float32)
    found = of.log_prob(jnp.broadcast_to(params, (4, 6, 4)), drawn)
    action = np.float64(of.action(drawn))
    one, other = density(box, 0.3, 0.5)(action[..., 0]), density(box, -1.0, 1.2)(action[..., 1])
    np.testing.assert_allclose(found, np.log(one * other), rtol=1e-4, atol=1e-4)
    assert found.shape == (4, 6) and of.num_params == 4
    assert of.noise(jax.random.key(0)).shape == (2,)


@each_box
@each_normal
def test_drawn_actions_follow_the_density(box, mean, scale):
    of, params = tanh_normal(box), parameters(mean, scale)
    noise = jax.vmap(of.noise)(jax.random.split(jax.random.key(3), 20_000))
    action = np.float64(of.action(jax.vmap(of.draw, (None, 0))(params, noise)))[:, 0]
    half = (box.high - box.low) / 2

    def distribution_function(action):
        y = np.clip((action - box.low) / half - 1, -1, 1)
        return stats.norm.cdf(np.arctanh(y), mean, scale)

    with np.errstate(divide="ignore"):  # actions that round to a bound
        assert stats.kstest(action, distribution_function).pvalue > 1e-3


@each_box
def test_actions_keep_within_their_bounds_however_far_is_drawn(box):
    of = tanh_normal(box)
    drawn = jnp.float32([-1e30, -100, -9, -1, 0, 1, 9, 100, 1e30])[:, None]
    action = np.asarray(of.action(drawn))
    assert (action >= box.low).all() and (action <= box.high).all()
    assert action[0] == box.low and action[-1] == box.high
    np.testing.assert_allclose(action[4], (box.low + box.high) / 2)


def test_bounds_that_no_float32_is_are_kept_too():
    draw = np.random.default_rng(0)
    far = jnp.float32([[-30.0], [30.0]])
    for low, size in zip(draw.normal(size=300), draw.exponential(size=300), strict=True):
        box = Box((1,), float(low), float(low + size))
        lowest, highest = np.asarray(tanh_normal(box).action(far))[:, 0]
        assert np.float32(box.low) <= lowest < highest <= np.float32(box.high)


def test_far_beyond_where_tanh_is_one_the_density_is_that_of_float64():
    of, params = tanh_normal(Box((1,), -2.0, 2.0)), parameters(0.0, 3.0)
    drawn = np.array([-40.0, -20, -12, 12, 20, 40])
    # log(1 - tanh²) = log 4 - 2 |u| - 2 log(1 + exp(-2 |u|))
    stretch = np.log(4) - 2 * np.abs(drawn) - 2 * np.log1p(np.exp(-2 * np.abs(drawn))) + np.log(2)
    expected = stats.norm.logpdf(drawn, 0, 3) - stretch
    found, slope = jax.vmap(jax.value_and_grad(of.log_prob), (None, 0))(params, jnp.float32(drawn)[:, None])
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert np.isfinite(slope).all()


@each_normal
def test_the_squashed_kl_is_an_integral_over_actions(mean, scale):
    box = BOXES[1]
    of = tanh_normal(box)
    for other_mean, other_scale in [(0.3, 0.7), (-1.5, 1.0), (0.0, 2.0)]:
        old, new = density(box, mean, scale), density(box, other_mean, other_scale)

        def summand(action, old=old, new=new):
            p, q = old(action), new(action)
            return p * np.log(p / q) if min(p, q) > 1e-300 else 0.0

        found = of.kl(parameters(mean, scale), parameters(other_mean, other_scale))
        np.testing.assert_allclose(found, integral(box, summand), rtol=1e-4, atol=1e-5)
    same = parameters(mean, scale)
    np.testing.assert_allclose(of.kl(same, same), 0, atol=1e-6)


def entropy_by_integral(box, mean, scale):
    of_action = density(box, mean, scale)

    def summand(action):
        p = of_action(action)
        return -p * np.log(p) if p > 1e-300 else 0.0

    return integral(box, summand)


@each_box
@each_normal
def test_the_entropy_is_right_in_the_mean_of_many_draws_also_of_older_parameters(box, mean, scale):
    of, new = tanh_normal(box), parameters(mean, scale)
    old = parameters(mean + 0.4, 1.3 * scale)
    noise = jax.vmap(of.noise)(jax.random.split(jax.random.key(5), 40_000))
    drawn = jax.vmap(of.draw, (None, 0))(old, noise)
    found = np.float64(jax.vmap(of.entropy, (None, None, 0))(new, old, drawn))
    error = found.std() / np.sqrt(len(found))
    assert abs(found.mean() - entropy_by_integral(box, mean, scale)) < 4 * error + 1e-4
    assert error < 0.03

    # So is the gradient, which is all that a learner sees of it.
    def in_the_mean(params):
        return jax.vmap(of.entropy, (None, None, 0))(params, old, drawn).mean()

    of_mean, of_raw = jax.grad(in_the_mean)(new)
    width = 1e-3
    by_mean, by_scale = (
        (entropy_by_integral(box, mean + a, scale + b) - entropy_by_integral(box, mean - a, scale - b))
        / (2 * width)
        for a, b in ((width, 0), (0, width))
    )
    slope = special.expit(float(new[1]))  # of softplus
    np.testing.assert_allclose([of_mean, of_raw], [by_mean, by_scale * slope], atol=0.05)


@each_normal
def test_greedy_is_the_middle_one_of_all_actions(mean, scale):
    box = BOXES[2]
    of, params = tanh_normal(box), parameters(mean, scale)
    np.testing.assert_allclose(of.mode(params), [mean], rtol=1e-6)
    np.testing.assert_allclose(of.action(of.mode(params)), [squashed(box, mean)], rtol=1e-6)
    nothing = jnp.zeros((1,))
    np.testing.assert_array_equal(of.draw(params, nothing), of.mode(params))


def test_a_scale_never_vanishes():
    of, params = tanh_normal(Box((1,), -1.0, 1.0)), jnp.float32([0.2, -200.0])
    noise = jnp.ones(1)
    np.testing.assert_allclose(of.draw(params, noise) - 0.2, MIN_SCALE, rtol=1e-3)
    log_prob = of.log_prob(params, of.draw(params, noise))
    np.testing.assert_allclose(log_prob, np.log(density(BOXES[0], 0.2, MIN_SCALE)(np.tanh(0.201))), rtol=1e-4)


def test_the_space_decides():
    assert make_distribution(Discrete(15)).num_params == 15
    assert make_distribution(Box((3,), -1.0, 1.0)).num_params == 6


@pytest.mark.parametrize(
    "space", [Box((2,)), Box((2,), 0.0), Box((2,), -1.0, float("nan")), Box((2, 2), -1.0, 1.0), {}], ids=str
)
def test_spaces_without_a_policy_are_refused(space):
    with pytest.raises(InputError, match="no policy for the action space") as refused:
        make_distribution(space)
    assert "\n" not in str(refused.value)
