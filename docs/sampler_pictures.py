"""The pictures of samplers.md: what each sampler makes of one simulated history.

    python docs/sampler_pictures.py                           # all, into docs/images/samplers
    python docs/sampler_pictures.py pec mine:Sampler --out my_pictures

Every sampler hears the same outcomes, of configurations drawn uniformly, so that pictures can be compared.
In a training each hears what it drew itself, and what it draws changes what is learned: that is for studies.
"""

from __future__ import annotations

import argparse
import sys
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from PIL import Image

from pecjax.curriculum import Outcomes, SamplerSettings
from pecjax.plotting.style import BLUE, PAGE, RED, YELLOW, name_panels, set_title, styled
from pecjax.training.kinds import make_kind

NAMES = (
    "uniform", "pec", "forgetting", "failure_ema", "learnability", "pass_at_n",
    "table_top", "thompson", "learning_progress", "dro", "plr", "sfl",
)  # fmt: skip
NUM_BATCHES, NUM_EPISODES = 200, 20  # episodes that end in a batch
SOLVED, LEARNED, FAILED = 4, 32, 4  # configurations: always solved, learned one after another, always failed
NUM_CONFIGS = SOLVED + LEARNED + FAILED
RISE = 12.0  # batches in which the odds of a success rise e-fold
SHOWN = 100  # the batch after which probabilities are drawn as bars too

# The darker, the more often: in grey as in colour.
_COLOURS = LinearSegmentedColormap.from_list("draws", ["white", YELLOW, RED, BLUE]).with_extremes(bad="white")
_SHARES = LogNorm(0.1, 10)
_CHANCES = LinearSegmentedColormap.from_list("chances", ["white", BLUE])
_OUTCOMES = LinearSegmentedColormap.from_list("outcomes", [YELLOW, BLUE]).with_extremes(bad="white")
_MAP: dict[str, Any] = {"aspect": "auto", "origin": "lower", "interpolation": "nearest"}
NUM_COLOURS, DPI = 256, 200  # of a picture


class History(NamedTuple):
    """What became of T batches of B episodes, and the chances behind it.

    Attributes:
        chance: (T, N) of success, of the configurations from easy to hard.
        ids: (N,) int, the numbers by which the sampler knows them: easy and hard ones mixed.
        outcomes: arrays (T, B); the signal is a positive value loss.
    """

    chance: np.ndarray
    ids: np.ndarray
    outcomes: Outcomes


def simulate(seed: int = 0) -> History:
    """A learner that masters one configuration after another, some from the start and some never."""
    draw = np.random.default_rng(seed)
    time = np.arange(NUM_BATCHES)[:, None]
    learned_at = np.linspace(0.05, 1, LEARNED) * NUM_BATCHES
    chance = np.concatenate([
        np.ones((NUM_BATCHES, SOLVED)),
        1 / (1 + np.exp(-(time - learned_at) / RISE)),
        np.zeros((NUM_BATCHES, FAILED)),
    ], axis=1)  # fmt: skip
    ids = draw.permutation(NUM_CONFIGS)
    place = draw.integers(0, NUM_CONFIGS, (NUM_BATCHES, NUM_EPISODES))
    expected = np.take_along_axis(chance, place, axis=1)
    failed = draw.random(place.shape) >= expected
    # A critic that knows the chance is surprised for the better by a success only.
    signal = np.where(failed, 0.0, 1 - expected)
    outcomes = Outcomes(
        jnp.asarray(ids[place], jnp.int32), jnp.ones(place.shape, bool), jnp.asarray(failed),
        jnp.full(place.shape, 100), jnp.asarray(~failed, jnp.float32), jnp.asarray(signal, jnp.float32),
    )  # fmt: skip
    return History(chance, ids, outcomes)


def shares(settings: SamplerSettings, history: History) -> np.ndarray:
    """Probabilities (T, N) after each batch as multiples of 1 / N, the configurations from easy to hard."""
    sampler = settings.make(NUM_CONFIGS)

    def hear(state: Any, batch: Outcomes) -> tuple[Any, jax.Array]:
        state = sampler.update(state, batch)
        return state, sampler.probabilities(state)

    _, probabilities = jax.jit(lambda told: jax.lax.scan(hear, sampler.init(), told))(history.outcomes)
    return np.asarray(probabilities)[:, history.ids] * NUM_CONFIGS


def summary(share: np.ndarray, chance: np.ndarray) -> list[float]:
    """Where the draws of all batches go: shares of them, and how many configurations they come to.

    Returns:
        to what is always solved; to what succeeds in 0.1 to 0.9 of the time; to what always fails; the
        exponential of the entropy, in the middle of the batches.
    """
    drawn = share / NUM_CONFIGS
    surprise = -np.log(np.where(drawn > 0, drawn, 1))
    return [
        float(drawn[:, :SOLVED].sum(axis=1).mean()),
        float(np.where((chance > 0.1) & (chance < 0.9), drawn, 0).sum(axis=1).mean()),
        float(drawn[:, -FAILED:].sum(axis=1).mean()),
        float(np.median(np.exp((drawn * surprise).sum(axis=1)))),
    ]


@styled
def draw_history(history: History) -> Figure:
    """The true chances, and the episodes that the samplers hear of."""
    figure = Figure((PAGE, 2.1), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    image = left.imshow(history.chance.T, cmap=_CHANCES, vmin=0, vmax=1, **_MAP)
    figure.colorbar(image, ax=left, pad=0.02).set_label("Chance of success")
    batch, _ = np.indices(history.outcomes.done.shape)
    told = np.zeros((2, *history.chance.shape))
    failed = np.asarray(history.outcomes.failed)
    np.add.at(told, (failed.astype(int), batch, np.asarray(history.outcomes.config_id)), 1)
    successes, trials = told[0][:, history.ids], told.sum(axis=0)[:, history.ids]
    ratio = np.divide(successes, trials, out=np.full(trials.shape, np.nan), where=trials > 0)
    right.imshow(ratio.T, cmap=_OUTCOMES, vmin=0, vmax=1, **_MAP)
    for axes in (left, right):
        _frame(axes, history.chance)
    name_panels([left, right], ["What is true", "What is heard (dark: success, pale: failure)"])
    left.set_ylabel("Configurations,\neasy to hard")
    return figure


@styled
def draw_sampler(name: str, share: np.ndarray, chance: np.ndarray) -> Figure:
    """Its probabilities over the batches, and those after one of them as bars."""
    figure = Figure((PAGE, 2.2), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(4, 1))
    _heat(left, share, chance)
    left.axvline(SHOWN, color="0.35", linewidth=0.8, linestyle="--")
    left.set_ylabel("Configurations,\neasy to hard")
    right.barh(np.arange(NUM_CONFIGS), share[SHOWN], height=1, color="0.6")
    right.axvline(1, color="black", linewidth=0.8, linestyle=":")
    name_panels([left, right], ["Probabilities", f"After batch {SHOWN}"])
    right.set_xlabel("Probability, × uniform")
    right.set_xlim(0, max(2.0, 1.05 * share[SHOWN].max()))
    _scale(figure, [left, right])
    set_title(figure, name)
    return figure


@styled
def draw_all(found: dict[str, np.ndarray], chance: np.ndarray) -> Figure:
    """The probabilities of all, on one page."""
    rows = -(-len(found) // 3)
    figure = Figure((PAGE, 1.5 * rows + 0.3), layout="constrained")
    cells = figure.subplots(rows, 3, sharex=True, sharey=True, squeeze=False)
    for axes in cells.ravel()[len(found) :]:
        axes.set_axis_off()
    for axes, share in zip(cells.ravel(), found.values(), strict=False):
        _heat(axes, share, chance)
        axes.label_outer()
    name_panels(cells.ravel().tolist()[: len(found)], found)
    _scale(figure, cells.ravel().tolist())
    return figure


def _heat(axes: Axes, share: np.ndarray, chance: np.ndarray) -> None:
    axes.imshow(share.T, cmap=_COLOURS, norm=_SHARES, **_MAP)
    _frame(axes, chance)


def _frame(axes: Axes, chance: np.ndarray) -> None:
    """Lines around what is being learned, and the names of what never changes."""
    axes.contour(chance.T, levels=[0.1, 0.9], colors="black", linewidths=0.7)
    axes.set_xlabel("Batch")
    axes.set(yticks=[1.5, NUM_CONFIGS - 2.5], yticklabels=["Always\nsolved", "Always\nfails"])
    axes.tick_params(axis="y", length=0)
    for border in (SOLVED - 0.5, NUM_CONFIGS - FAILED - 0.5):
        axes.axhline(border, color="black", linewidth=0.5, linestyle=":")


def _scale(figure: Figure, of: list[Axes]) -> None:
    bar = figure.colorbar(ScalarMappable(_SHARES, _COLOURS), ax=of, pad=0.02, extend="both", aspect=30)
    bar.set_label("Probability, × uniform")
    bar.set_ticks([0.1, 0.3, 1, 3, 10], labels=["0.1", "0.3", "1", "3", "10"])
    bar.minorticks_off()


def save(figure: Figure, path: Path) -> None:
    """Writes a PNG of few colours: a third of the size."""
    file = BytesIO()
    figure.savefig(file, dpi=DPI)
    few = (
        Image.open(file)
        .convert("RGB")
        .quantize(NUM_COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    )
    few.save(path, optimize=True)


def main(words: list[str] | None = None) -> None:
    """Draws the samplers that are named, and prints where each one's draws go."""
    parser = argparse.ArgumentParser(description="Pictures of samplers on one simulated history.")
    parser.add_argument("samplers", nargs="*", default=NAMES)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "images" / "samplers")
    options = parser.parse_args(words)
    history = simulate()
    found = {name: shares(make_kind("sampler", name), history) for name in options.samplers}
    options.out.mkdir(parents=True, exist_ok=True)
    figures = {name.rpartition(":")[2]: draw_sampler(name, found[name], history.chance) for name in found}
    figures |= {"history": draw_history(history), "all": draw_all(found, history.chance)}
    for name, figure in figures.items():
        save(figure, options.out / f"{name}.png")
    for name, share in found.items():
        solved, learned, failed, number = summary(share, history.chance)
        print(f"| `{name}` | {solved:.2f} | {learned:.2f} | {failed:.2f} | {number:.0f} |")


if __name__ == "__main__":
    sys.path.append("")  # samplers of one's own lie in the folder that this is run in, as for `pecjax`
    main()
