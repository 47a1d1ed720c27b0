"""PLR: prioritized level replay, by the learner's score of each episode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp

from pecjax.curriculum.base import Outcomes, Sampler, SamplerSettings, by_config, count_outcomes
from pecjax.curriculum.numbers import Numbers, check_number
from pecjax.curriculum.statistics import from_statistics, ids_in_batch, learn_alone
from pecjax.errors import InputError

MOST_RANKED = 100_000  # configurations that are sorted for every draw
Score = Literal["signal", "max_mc", "solved_signal"]
UNSEEN = -1  # in place of the batch that it was last seen in


@dataclass(frozen=True)
class PLR(SamplerSettings):
    """Replays configurations by the learner's score, and by how long ago they were seen (see `plr`).

    Attributes:
        replay: the chance to replay a seen configuration, while there are unseen ones.
        staleness: the share of the replays that are drawn by age.
        temperature: the temperature of the scores; the larger, the nearer to uniform.
        rank: whether scores count by rank, else in proportion.
        score: the learner's signal itself; or `max_mc`, the regret beside the best return so far, for which
            the signal is to be the mean value (`--agent.signal value`); or `solved_signal`, the signal where
            an episode has ever succeeded, else 0.
    """

    replay: float = 0.5
    staleness: float = 0.3
    temperature: float = 0.3
    rank: bool = True
    score: Score = "signal"

    def make(self, num_configs: int) -> Sampler:
        """The sampler over N configurations."""
        return plr(num_configs, self.replay, self.staleness, self.temperature, self.rank, self.score)


class Seen(NamedTuple):
    """What was seen, how it was scored, and when.

    Attributes:
        score: (N,) float32, of the last batch with episodes of it; 0 or more.
        last: (N,) int32, the number of that batch; `UNSEEN` where there was none.
        batch: () int32, how many batches with an episode there have been.
        best: (N,) float32, the highest return of an episode of it by `max_mc`, 1 or 0 for whether one has
            succeeded by `solved_signal`; None where the score is the signal.
    """

    score: jax.Array
    last: jax.Array
    batch: jax.Array
    best: jax.Array | None


class Heard(NamedTuple):
    """A batch.

    Attributes:
        trials: (N,) int32, episodes that ended.
        signal: (N,) float32, the sum of their signals.
        best: (N,) float32, the highest of their returns, or of their successes, as in `Seen`.
        ids: as `ids_in_batch` has them.
    """

    trials: jax.Array
    signal: jax.Array
    best: jax.Array | None
    ids: jax.Array | None


def plr(
    num_configs: int,
    replay: Any = 0.5,
    staleness: Any = 0.3,
    temperature: Any = 0.3,
    rank: bool = True,
    score: Score = "signal",
) -> Sampler:
    """Prioritized level replay over a table (Jiang et al. 2021, Eq. 1-3).

        P_n = replay * ((1 - ρ) h_n^(1/β) / Σ h^(1/β) + ρ (c - c_n) / Σ (c - c_i))   of what was seen
        P_n = (1 - replay) / unseen                                                  of what was not

    with staleness ρ, temperature β, h = 1 / rank of the score or the score itself, and the batch c_n that
    it was last seen in. When nothing is unseen, all is replayed. Scores are means over a batch's episodes of
    their `signal`, such as the mean positive advantage; or by `max_mc` (Jiang et al. 2021, "Replay-guided
    adversarial environment design") of R - signal, with the highest return R that an episode of the
    configuration has had, and the mean value of its steps as signal; or by `solved_signal` 0 as long as no
    episode of the configuration has succeeded (with `--agent.signal maximised_negative_advantage` the MNA of
    Mead et al. 2026). Below 0 they count as 0.

    Raises:
        InputError: fewer than one configuration, more than `MOST_RANKED` by rank, no such score, or a
            number out of its range; at an update, outcomes without a signal, or by `max_mc` without an
            episode return.
    """
    check_number("replay", replay, 0, 1)
    check_number("staleness", staleness, 0, 1)
    check_number("temperature", temperature, 0, above=True)
    if score not in get_args(Score):
        raise InputError(f"score is {score!r}; it is one of {', '.join(get_args(Score))}")
    if rank and num_configs > MOST_RANKED:
        raise InputError(
            f"num_configs is {num_configs}; by rank there may be {MOST_RANKED}, as all are sorted for every "
            "draw: take the proportional form (rank False)"
        )

    def begin() -> Seen:
        worst = {"max_mc": -jnp.inf, "solved_signal": 0.0}
        best = jnp.full(num_configs, worst[score]) if score in worst else None
        return Seen(jnp.zeros(num_configs), jnp.full(num_configs, UNSEEN, jnp.int32), jnp.int32(0), best)

    def learn(seen: Seen, heard: Heard, _: Numbers) -> Seen:
        def of_each(known: tuple[Any, ...], new: tuple[Any, ...]) -> tuple[Any, ...]:
            (before, last, best), (trials, signal, highest) = known, new
            found = signal / jnp.maximum(trials, 1)
            if best is not None:
                best = jnp.maximum(best, highest)
                found = best - found if score == "max_mc" else best * found
            tried = trials > 0
            return jnp.where(tried, jnp.maximum(found, 0.0), before), jnp.where(tried, seen.batch, last), best

        scores, last, best = learn_alone(
            of_each, (seen.score, seen.last, seen.best), (heard.trials, heard.signal, heard.best), heard.ids
        )
        return Seen(scores, last, seen.batch + heard.trials.any(), best)

    def weight(seen: Seen, numbers: Numbers) -> jax.Array:
        is_seen, share = seen.last != UNSEEN, numbers["staleness"]
        by_score = _by_rank if rank else _in_proportion
        score = jnp.where(is_seen, by_score(seen.score, is_seen, 1 / numbers["temperature"]), 0.0)
        age = jnp.where(is_seen, seen.batch - seen.last, 0).astype(jnp.float32)
        number = is_seen.sum()
        unseen = num_configs - number
        chance = jnp.where(unseen == 0, 1.0, jnp.where(number > 0, numbers["replay"], 0.0))
        # The whole of each part first, so that one pass puts them together. What has no whole is even.
        of_score, even_score = _factors(chance * (1 - share), score.sum(), number)
        of_age, even_age = _factors(chance * share, age.sum(), number)
        replayed = of_score * score + of_age * age + even_score + even_age
        return jnp.where(is_seen, replayed, (1 - chance) / jnp.maximum(unseen, 1))

    def hear(outcomes: Outcomes, number: int, axis_name: str | None) -> Heard:
        trials, failures = count_outcomes(outcomes, number, axis_name)
        signal, highest = by_config(outcomes, "signal", number, "sum", axis_name), None
        if score == "max_mc":
            highest = by_config(outcomes, "episode_return", number, "max", axis_name)
        elif score == "solved_signal":
            highest = (failures < trials).astype(jnp.float32)
        return Heard(trials, signal, highest, ids_in_batch(outcomes, number, axis_name))

    numbers = {"replay": replay, "staleness": staleness, "temperature": temperature}
    return from_statistics(num_configs, numbers, begin, learn, weight, hear)


def _by_rank(score: jax.Array, is_seen: jax.Array, power: jax.Array) -> jax.Array:
    """rank^(-power), the highest score of those seen being the first."""
    order = jnp.argsort(jnp.where(is_seen, -score, jnp.inf), stable=True)
    rank = jnp.zeros(len(order)).at[order].set(jnp.arange(1.0, len(order) + 1))
    return jnp.exp(-power * jnp.log(rank))


def _in_proportion(score: jax.Array, is_seen: jax.Array, power: jax.Array) -> jax.Array:
    """score^power, beside the highest: large powers of small scores would vanish."""
    highest = jnp.where(is_seen, score, 0.0).max()
    return jnp.exp(power * jnp.log(jnp.maximum(score / jnp.where(highest > 0, highest, 1.0), 1e-30)))


def _factors(mass: jax.Array, whole: jax.Array, number: jax.Array) -> tuple[jax.Array, jax.Array]:
    """What to multiply weights by, so that their whole is `mass`, and what each of so many gets beside.

    The second is 0, unless the whole is: then all get alike.
    """
    is_even = whole <= 0
    of_weight = mass / jnp.where(is_even, 1.0, whole)
    return jnp.where(is_even, 0.0, of_weight), jnp.where(is_even, mass / jnp.maximum(number, 1), 0.0)
