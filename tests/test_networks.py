"""Features, shapes, initial weights, and the wall between actor and critic."""

from functools import cache
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pecjax.agents.convolutions import patches
from pecjax.agents.networks import ActorCritic, NetworkSettings, decide, forward
from pecjax.agents.observations import boxes, encode, image_shapes, num_values
from pecjax.agents.ppo.agent import critic_features
from pecjax.agents.products import bfloat16_product
from pecjax.agents.rollout import Seen
from pecjax.envs.rooms.sensing import scale
from pecjax.envs.spaces import Box

ACTIONS, FAR = 15, 10.0
MLP = NetworkSettings()
NORMC = NetworkSettings(hidden=(256, 256), initializer="normc")
CNN = NetworkSettings(encoder="cnn", hidden=(32,))


def space(height: int, width: int):
    return {"depth": Box((height, width), 0.01, 1.0), "goal": Box((3,))}


def seen(obs):
    """The features of what a drone senses, in SI units."""
    return encode(space(*obs["depth"].shape[-2:]), scale(obs, FAR))


def features(*batch: int, height: int = 12, width: int = 16, seed: int = 0):
    draw = np.random.default_rng(seed)
    depth = draw.uniform(0.1, FAR, (*batch, height, width))
    goal = np.stack([draw.uniform(0, 18, batch), draw.uniform(-np.pi, np.pi, batch)], axis=-1)
    return seen({"depth": jnp.asarray(depth, jnp.float32), "goal": jnp.asarray(goal, jnp.float32)})


@cache
def made(settings: NetworkSettings, height: int = 12, width: int = 16):
    network = ActorCritic(settings, ACTIONS, image_shapes(space(height, width)))
    params = jax.jit(network.init)(jax.random.key(0), features(1, height=height, width=width))
    return network, params, jax.jit(lambda params, obs: forward(network, params, obs)[:2])


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
        outputs, pull_back = jax.vjp(lambda p: forward(network, p, obs)[:2], params)
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


def test_features_scale_depth_and_distance_and_turn_the_bearing_into_a_point():
    obs = {
        "depth": jnp.array([[0.1, 5.0], [10.0, 2.5]]),
        "goal": jnp.array([5.0, np.pi / 2]),
    }
    np.testing.assert_allclose(seen(obs), [0.01, 0.5, 1.0, 0.25, 0.5, 1.0, 0.0], atol=1e-6)


def test_features_have_no_jump_behind_the_drone():
    def at(bearing: float):
        return seen({"depth": jnp.ones((1, 1)), "goal": jnp.array([1.0, bearing])})

    np.testing.assert_allclose(at(np.pi - 1e-4), at(-np.pi + 1e-4), atol=3e-4)
    assert np.abs(at(0.5) - at(-0.5)).max() > 0.9  # while left and right are told apart


# Numbers before, between and after images, in the order of a tree's keys.
MANY = {
    "a": Box((2,)),
    "b": Box((2, 3), 0.0, 1.0),
    "c": (Box(()), Box((17, 20, 3), -1.0, 1.0)),
    "d": Box((1,)),
}


def some_of_many(*batch: int):
    draw = np.random.default_rng(2)
    return jax.tree.map(lambda box: jnp.asarray(draw.uniform(size=(*batch, *box.shape)), jnp.float32), MANY)


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_images_come_first_in_the_features_whatever_their_place(batch):
    obs = some_of_many(*batch)
    in_order = [obs["b"], obs["c"][1], obs["a"], obs["c"][0], obs["d"]]
    flat = np.concatenate([np.reshape(part, (*batch, -1)) for part in in_order], axis=-1)
    np.testing.assert_array_equal(encode(MANY, obs), flat)
    assert image_shapes(MANY) == ((2, 3), (17, 20, 3))
    assert num_values(MANY) == flat.shape[-1] == 6 + 17 * 20 * 3 + 2 + 1 + 1
    assert [box.shape for box in boxes(MANY)] == [(2, 3), (17, 20, 3), (2,), (), (1,)]


@pytest.mark.parametrize("batch", [(), (4,), (4, 5)])
def test_a_critic_is_told_what_is_no_image_and_the_middle_row_of_images(batch):
    task = SimpleNamespace(observation_space=MANY, privileged_space=Box((6,)))
    obs, told = some_of_many(*batch), jnp.ones((*batch, 6))
    others = [obs["a"], obs["c"][0][..., None], obs["d"]]
    rows = [obs["b"][..., 1, :], obs["c"][1][..., 8, :, :].reshape(*batch, 60)]
    for critic, parts in (("privileged", [told, *others]), ("privileged_row", [told, *rows, *others])):
        found = critic_features(task, Seen(obs, told), critic)
        np.testing.assert_array_equal(found, np.concatenate(parts, axis=-1))


@pytest.mark.parametrize("settings", [MLP, CNN], ids=["mlp", "cnn"])
def test_a_privileged_critic_reads_what_it_knows_and_the_actor_does_not(settings):
    network = ActorCritic(settings, ACTIONS, image_shapes(space(48, 64)), is_privileged=True)
    rows, others = (features(3, height=48, width=64, seed=seed) for seed in (0, 1))
    known = jnp.asarray(np.random.default_rng(2).normal(size=(3, 7)), jnp.float32)
    params = network.init(jax.random.key(0), rows[:1], known[:1])
    logits, value, *_ = forward(network, params, rows, known)
    assert logits.shape == (3, ACTIONS) and value.shape == (3,)
    of_others, same_value, *_ = forward(network, params, others, known)
    same_logits, other_value, *_ = forward(network, params, rows, -known)
    np.testing.assert_array_equal(same_value, value)
    np.testing.assert_array_equal(same_logits, logits)
    assert np.abs(of_others - logits).min(axis=0).max() > 0 and np.abs(other_value - value).min() > 0
    np.testing.assert_allclose(decide(network, params, rows).params, logits, atol=1e-3)  # in float32
    assert "critic_convolutions" not in params["params"]  # it sees no image


@pytest.mark.parametrize("has_columns", [False, True])
@pytest.mark.parametrize("batch", [(), (5,), (2, 3)])
def test_products_of_16_bits_are_those_of_rounded_numbers(batch, has_columns):
    """And so are their gradients, of kernels where the rows are at hand in columns; sums are of 32 bits."""
    draw = np.random.default_rng(3)
    x, kernel, pull = (draw.normal(size=shape) for shape in ((*batch, 40), (40, 6), (*batch, 6)))

    def rounded(array):
        return np.float64(jnp.asarray(array, jnp.bfloat16))

    def product(x, kernel):
        columns = x.reshape(-1, 40).T if has_columns else None
        return bfloat16_product(columns)(x, kernel, (((x.ndim - 1,), (0,)), ((), ())))

    found, pull_back = jax.vjp(product, jnp.float32(x), jnp.float32(kernel))
    of_x, of_kernel = pull_back(jnp.float32(pull))
    close = {"rtol": 1e-5, "atol": 1e-5}
    np.testing.assert_allclose(found, rounded(x) @ rounded(kernel), **close)
    np.testing.assert_allclose(of_x, rounded(pull) @ rounded(kernel).T, **close)
    columns, ends = (rounded(x), rounded(pull)) if has_columns else (x, pull)
    np.testing.assert_allclose(of_kernel, columns.reshape(-1, 40).T @ ends.reshape(-1, 6), **close)
    assert found.dtype == of_x.dtype == of_kernel.dtype == jnp.float32
    assert np.abs(np.asarray(found) - x @ kernel).max() > 1e-3  # and it matters


def test_an_observation_that_is_one_array_is_a_space_of_one_box():
    draw = np.random.default_rng(3)
    row, image = draw.normal(size=(5, 4)), draw.normal(size=(5, 4, 6))
    np.testing.assert_array_equal(encode(Box((4,)), jnp.float32(row)), np.float32(row))
    np.testing.assert_array_equal(encode(Box((4, 6)), jnp.float32(image)), np.float32(image.reshape(5, 24)))
    assert image_shapes(Box((4,))) == () and image_shapes(Box((4, 6))) == ((4, 6),)


def test_several_images_of_any_depth_each_pass_convolutions_of_their_own():
    network = ActorCritic(CNN, ACTIONS, image_shapes(MANY))
    obs = some_of_many(3)
    rows = encode(MANY, obs)
    params = jax.jit(network.init)(jax.random.key(0), rows)
    logits, value, *_ = forward(network, params, rows)
    assert logits.shape == (3, ACTIONS) and value.shape == (3,)
    convolutions = params["params"]["actor_convolutions"]
    # Three layers of each image, the first over 4×4 pixels of its own channels.
    assert [convolutions[f"Dense_{n}"]["kernel"].shape[0] for n in (0, 3)] == [16 * 1, 16 * 3]
    assert len(convolutions) == 6

    # Each part has a say: a change in any of them changes what comes out.
    for place in range(5):
        leaves, tree = jax.tree.flatten(obs)
        leaves[place] = leaves[place] + 0.5
        other, *_ = forward(network, params, encode(MANY, jax.tree.unflatten(tree, leaves)))
        assert np.abs(other - logits).max() > 1e-6


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
