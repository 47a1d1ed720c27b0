"""What holds for every sampler: a suite to extend by the settings of one.

class TestMine(SamplerContract):
    settings = Mine(floor=0.1)
"""

import jax
import numpy as np
import pytest
from jax import numpy as jnp
from jax.sharding import Mesh, PartitionSpec
from scipy import stats

from pecjax import InputError, settings_tree
from pecjax.curriculum import Outcomes, SamplerSettings

N = 12


def some_outcomes(shape, seed=0):
    rng = np.random.default_rng(seed)
    return Outcomes(
        jnp.asarray(rng.integers(0, N - 2, shape), jnp.int32),  # two are never tried
        jnp.asarray(rng.random(shape) < 0.4),
        jnp.asarray(rng.random(shape) < 0.5),
        jnp.asarray(rng.integers(1, 50, shape), jnp.int32),
        jnp.asarray(rng.normal(size=shape), jnp.float32),
        jnp.asarray(rng.random(shape), jnp.float32),
    )


def assert_alike(one, other):
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-7), one, other)


class SamplerContract:
    settings: SamplerSettings

    @pytest.fixture(scope="class")
    def sampler(self):
        return self.settings.make(N)

    @pytest.fixture(scope="class")
    def learnt(self, sampler):
        """The state after a few hundred outcomes."""
        return jax.jit(sampler.update)(sampler.init(), some_outcomes((40, 16)))

    def test_the_settings_are_a_kind_that_reads_back(self):
        content = settings_tree.to_json(self.settings, declared=SamplerSettings)
        assert settings_tree.from_json(content, SamplerSettings) == self.settings
        assert type(self.settings).__dataclass_params__.frozen

    @pytest.mark.parametrize("num_configs", [0, -3])
    def test_no_configuration_is_refused(self, num_configs):
        with pytest.raises(InputError, match="num_configs is"):
            self.settings.make(num_configs)

    def test_probabilities_are_probabilities(self, sampler, learnt):
        for state in (sampler.init(), learnt):
            chances = np.asarray(jax.jit(sampler.probabilities)(state))
            assert chances.shape == (N,) and np.all(chances >= 0)
            np.testing.assert_allclose(chances.sum(), 1, rtol=1e-5)

    def test_before_any_outcome_all_are_alike(self, sampler):
        np.testing.assert_allclose(sampler.probabilities(sampler.init()), np.full(N, 1 / N), rtol=1e-6)

    def test_draws_follow_the_probabilities(self, sampler, learnt):
        ids = jax.jit(sampler.sample, static_argnums=2)(learnt, jax.random.key(0), (100, 200))
        assert ids.shape == (100, 200) and ids.dtype == jnp.int32
        expected = np.float64(sampler.probabilities(learnt))
        drawn = np.bincount(np.ravel(ids), minlength=N)
        possible = expected > 0
        assert not drawn[~possible].any()
        expected = expected[possible] / expected.sum()
        assert stats.chisquare(drawn[possible], ids.size * expected).pvalue > 1e-3

    def test_a_single_draw_is_a_scalar_and_keys_decide(self, sampler):
        draw = jax.jit(sampler.sample)
        assert draw(sampler.init(), jax.random.key(0)).shape == ()
        keys = jax.random.split(jax.random.key(1), 30)
        first, again = ([int(draw(sampler.init(), key)) for key in keys] for _ in range(2))
        assert first == again and len(set(first)) > 5

    def test_an_update_keeps_structure_shapes_and_types(self, sampler, learnt):
        def signature(state):
            return jax.tree.structure(state), [(x.shape, x.dtype) for x in jax.tree.leaves(state)]

        assert signature(learnt) == signature(sampler.init())

    def test_a_state_that_is_kept_and_read_again_goes_on_bit_for_bit(self, sampler, learnt, tmp_path):
        leaves, structure = jax.tree.flatten(learnt)
        np.savez(tmp_path / "state.npz", *leaves)
        with np.load(tmp_path / "state.npz") as file:
            again = jax.tree.unflatten(structure, [jnp.asarray(file[name]) for name in file.files])

        def gone_on(state):
            for seed in range(3):
                state = jax.jit(sampler.update)(state, some_outcomes((20,), seed))
            return state, sampler.probabilities(state), sampler.sample(state, jax.random.key(2), 100)

        jax.tree.map(np.testing.assert_array_equal, gone_on(learnt), gone_on(again))

    def test_what_is_not_done_teaches_nothing(self, sampler, learnt):
        outcomes = some_outcomes((200,), seed=3)
        update = jax.jit(sampler.update)
        everything = update(learnt, outcomes)
        done = np.asarray(outcomes.done)
        only = jax.tree.map(lambda part: np.asarray(part)[done], outcomes)
        assert_alike(everything, update(learnt, only))
        assert_alike(learnt, update(learnt, outcomes._replace(done=jnp.zeros(200, bool))))

    def test_several_devices_learn_what_one_does(self, sampler, learnt):
        mesh = Mesh(np.array(jax.devices()[:2]), ("devices",))
        whole, split = PartitionSpec(), PartitionSpec(None, "devices")
        update = jax.shard_map(
            lambda state, outcomes: sampler.update(state, outcomes, axis_name="devices"),
            mesh=mesh, in_specs=(whole, split), out_specs=whole,
        )  # fmt: skip
        outcomes = some_outcomes((30, 16), seed=1)
        assert_alike(jax.jit(update)(learnt, outcomes), sampler.update(learnt, outcomes))

    @pytest.mark.parametrize(
        ("outcomes", "words"),
        [
            (Outcomes([3, N], [1, 1], [0, 0]), f"config_id {N} does not exist; .* 0 to {N - 1}"),
            (Outcomes([-1], [True], [True]), "config_id -1 does not exist"),
            (Outcomes([3], [1], [-1.0]), "failed is -1.0"),
            (Outcomes([3], [1], [np.nan]), "failed is nan"),
            (Outcomes([3], [2], [0]), "done is 2"),
            (Outcomes([3.0], [1], [0]), "config_id is of type float64; give integers"),
            (Outcomes([1, 2, 3], [1, 1], [0, 0]), r"config_id \(3,\), done \(2,\).* do not broadcast"),
        ],
    )
    def test_outcomes_that_cannot_be_meant_are_refused(self, sampler, outcomes, words):
        with pytest.raises(InputError, match=words):
            sampler.update(sampler.init(), outcomes)

    def test_a_study_over_its_numbers_is_a_vmap(self, sampler):
        """Other values that are in the range of any number there is: nearer to 0.1."""
        numbers = {k: v for k, v in settings_tree.leaves(self.settings) if isinstance(v, float)}
        varied = {name: jnp.asarray([v, 0.7 * v + 0.03], jnp.float32) for name, v in numbers.items()}

        def run(given):
            state = sampler.update(sampler.init(**given), some_outcomes((300,)))
            return sampler.probabilities(state), sampler.sample(state, jax.random.key(0), 50)

        both = jax.vmap(run, axis_size=2)(varied)
        for n in range(2):
            one = self.settings
            for name, values in varied.items():
                one = settings_tree.set_path(one, name, float(values[n]))
            alone = one.make(N)
            state = alone.update(alone.init(), some_outcomes((300,)))
            np.testing.assert_allclose(both[0][n], alone.probabilities(state), rtol=1e-6)
            np.testing.assert_array_equal(both[1][n], alone.sample(state, jax.random.key(0), 50))
        with pytest.raises(InputError, match="has no nothing"):
            sampler.init(nothing=1.0)
