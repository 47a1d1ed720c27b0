"""Shapes, initial weights, and the wall between actor and critic."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special, stats

from pecjax.agents.networks import ActorCritic, NetworkSettings, draw_action, encode, patches

ACTIONS, FAR = 15, 10.0
MLP = NetworkSettings()
NORMC = NetworkSettings(hidden=(256, 256), initializer="normc")
CNN = NetworkSettings(encoder="cnn", hidden=(32,))


def features(*batch: int, height: int = 12, width: int = 16, seed: int = 0):
    draw = np.random.default_rng(seed)
    depth = draw.uniform(0.1, FAR, (*batch, height, width))
    goal = np.stack([draw.uniform(0, 18, batch), draw.uniform(-np.pi, np.pi, batch)], axis=-1)
    return encode({"depth": jnp.asarray(depth, jnp.float32), "goal": jnp.asarray(goal, jnp.float32)}, FAR)


@cache
def made(settings: NetworkSettings, height: int = 12, width: int = 16):
    network = ActorCritic(settings, ACTIONS, (height, width))
    params = jax.jit(network.init)(jax.random.key(0), features(1, height=height, width=width))
    return network, params, jax.jit(network.apply)


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
@pytest.mark.parametrize(
    ("settings", "height", "width"), [(MLP, 12, 16), (CNN, 48, 64)], ids=["mlp 16x12", "cnn 64x48"]
)
def test_shapes_keep_the_batch_axes(settings, height, width, batch):
    _, params, apply = made(settings, height, width)
    logits, value = apply(params, features(*batch, height=height, width=width))
    assert logits.shape == (*batch, ACTIONS)
    assert value.shape == batch
    assert np.all(np.isfinite(logits)) and np.all(np.isfinite(value))


@pytest.mark.parametrize(
    ("settings", "height", "width"), [(MLP, 12, 16), (CNN, 48, 64)], ids=["mlp 16x12", "cnn 64x48"]
)
def test_a_batch_is_its_rows_one_by_one(settings, height, width):
    obs = features(3, height=height, width=width)
    _, params, apply = made(settings, height, width)
    together = apply(params, obs)
    for row in range(3):
        alone = apply(params, jax.tree.map(lambda leaf, row=row: leaf[row], obs))
        jax.tree.map(lambda a, b, row=row: np.testing.assert_allclose(a[row], b, atol=1e-6), together, alone)


def kernels(params, tower: str) -> list[np.ndarray]:
    """Of the dense layers, the first one first; the towers' first layers stand side by side."""
    layers = params["params"]
    first = np.split(np.asarray(layers["first"]["kernel"]), 2, axis=1)[tower == "critic"]
    return [first] + [np.asarray(layers[f"{tower}_{name}"]["kernel"]) for name in ("1", "output")]


@pytest.mark.parametrize("tower", ["actor", "critic"])
def test_normc_columns_have_unit_length_and_outputs_a_hundredth(tower):
    _, params, _ = made(NORMC)
    *hidden, output = kernels(params, tower)
    assert [kernel.shape for kernel in hidden] == [(16 * 12 + 3, 256), (256, 256)]
    for kernel in hidden:
        np.testing.assert_allclose(np.linalg.norm(kernel, axis=0), 1.0, rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(output, axis=0), 0.01, rtol=1e-5)


@pytest.mark.parametrize(("tower", "output_gain"), [("actor", 0.01), ("critic", 1.0)])
def test_orthogonal_gains(tower, output_gain):
    _, params, _ = made(MLP)
    *hidden, output = kernels(params, tower)
    for kernel, gain in [(kernel, np.sqrt(2)) for kernel in hidden] + [(output, output_gain)]:
        gram = kernel.T @ kernel
        np.testing.assert_allclose(gram, gain**2 * np.eye(len(gram)), atol=1e-5 * gain**2)


@pytest.mark.parametrize("settings", [MLP, NORMC], ids=["orthogonal", "normc"])
def test_biases_start_at_zero(settings):
    _, params, _ = made(settings)
    biases = [leaf for path, leaf in jax.tree.leaves_with_path(params) if "bias" in str(path[-1])]
    assert len(biases) == 5  # of the first layers together, then two for each tower
    assert not any(np.any(bias) for bias in biases)


@pytest.mark.parametrize(
    ("settings", "height", "width"),
    [(MLP, 12, 16), (NORMC, 12, 16), (CNN, 48, 64)],
    ids=["mlp", "normc", "cnn"],
)
def test_actor_and_critic_share_no_parameter(settings, height, width):
    obs = features(4, height=height, width=width)
    network, params, _ = made(settings, height, width)

    @jax.jit
    def gradients(params):
        """Of a function of the logits, and of one of the value."""
        outputs, pull_back = jax.vjp(lambda p: network.apply(p, obs), params)
        logits, value = jax.tree.map(jnp.cos, outputs)
        return pull_back((logits, 0 * value)), pull_back((0 * logits, value))

    def of_tower(gradient, tower: str) -> list[np.ndarray]:
        layers = dict(gradient[0]["params"])
        first = layers.pop("first", {})  # only the mlp has one
        halves = [np.split(np.asarray(leaf), 2, axis=-1)[tower == "critic"] for leaf in first.values()]
        return halves + jax.tree.leaves({k: v for k, v in layers.items() if k.startswith(tower)})

    towers = (("actor", "critic"), ("critic", "actor"))
    for gradient, (mine, other) in zip(gradients(params), towers, strict=True):
        assert not any(np.any(leaf) for leaf in of_tower(gradient, other))
        assert all(np.any(leaf) for leaf in of_tower(gradient, mine))
        counted = sum(leaf.size for tower in (mine, other) for leaf in of_tower(gradient, tower))
        assert counted == sum(leaf.size for leaf in jax.tree.leaves(params))


@pytest.mark.parametrize(
    ("settings", "height", "width"),
    [(MLP, 12, 16), (NORMC, 12, 16), (CNN, 48, 64)],
    ids=["mlp", "normc", "cnn"],
)
def test_every_action_is_nearly_as_likely_at_first(settings, height, width):
    obs = features(64, height=height, width=width)
    _, params, apply = made(settings, height, width)
    probabilities = jax.nn.softmax(apply(params, obs)[0])
    np.testing.assert_allclose(probabilities, 1 / ACTIONS, rtol=0.15)


def test_encode_scales_depth_and_distance_and_turns_the_bearing_into_a_point():
    obs = {
        "depth": jnp.array([[0.1, 5.0], [10.0, 2.5]]),
        "goal": jnp.array([5.0, np.pi / 2]),
    }
    np.testing.assert_allclose(encode(obs, far=10.0), [0.01, 0.5, 1.0, 0.25, 0.5, 1.0, 0.0], atol=1e-6)


def test_encode_has_no_jump_behind_the_drone():
    def at(bearing: float):
        return encode({"depth": jnp.ones((1, 1)), "goal": jnp.array([1.0, bearing])}, far=10.0)

    np.testing.assert_allclose(at(np.pi - 1e-4), at(-np.pi + 1e-4), atol=3e-4)
    assert np.abs(at(0.5) - at(-0.5)).max() > 0.9  # while left and right are told apart


@pytest.mark.parametrize(("height", "width", "size"), [(8, 12, 4), (7, 10, 4), (6, 5, 2)])
def test_a_product_over_patches_is_a_convolution_whose_kernels_do_not_overlap(height, width, size):
    draw = np.random.default_rng(0)
    image = draw.normal(size=(2, height, width, 3)).astype(np.float32)
    kernel = draw.normal(size=(size, size, 3, 5)).astype(np.float32)
    ours = patches(jnp.asarray(image), size) @ kernel.reshape(-1, 5)
    edge = [(0, -height % size), (0, -width % size)]
    layout = ("NHWC", "HWIO", "NHWC")
    theirs = jax.lax.conv_general_dilated(image, kernel, (size, size), edge, dimension_numbers=layout)
    np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5)


def test_an_action_is_the_distribution_function_inverted():
    draw = np.random.default_rng(1)
    logits, chance = draw.normal(size=(500, 15)), draw.uniform(size=500)
    weights = np.exp(logits)
    reached = np.cumsum(weights, axis=1) / weights.sum(axis=1, keepdims=True)
    expected = [np.searchsorted(row, at, side="right") for row, at in zip(reached, chance, strict=True)]
    np.testing.assert_array_equal(draw_action(jnp.float32(logits), jnp.float32(chance)), expected)


def test_drawn_actions_are_as_frequent_as_they_are_likely():
    logits = jnp.array([0.0, 3.0, -jnp.inf, 1.0])
    drawn = draw_action(jnp.tile(logits, (10**5, 1)), jax.random.uniform(jax.random.key(0), (10**5,)))
    found, likely = np.bincount(drawn, minlength=4), special.softmax(np.float64(logits))
    assert found[2] == 0
    assert stats.chisquare(found[likely > 0], 1e5 * likely[likely > 0]).pvalue > 1e-3


def test_an_action_is_never_one_too_many():
    # In float32 these 15 equal likelihoods may add up to less than the greatest chance.
    greatest = np.nextafter(np.float32(1), np.float32(0))
    assert draw_action(jnp.zeros(15), jnp.asarray(greatest)) == 14
