"""The published rules of the samplers in plain NumPy, trial by trial: what ours are compared with.

Nobody knows the order of the trials of one batch; each of them counts as the batch's mean outcome of its
configuration.
"""

import math

import numpy as np
from scipy import optimize


def trials_of(batch, n):
    """(mean failure, mean signal) of each trial of n in a batch of (id, failed, length, signal)."""
    own = [row for row in batch if row[0] == n]
    if not own:
        return []
    return [(np.mean([row[1] for row in own]), np.mean([row[3] for row in own]))] * len(own)


def memories(history, number, half_life):
    """Successes and failures (number, 2) that fade by 2^(-1 / half-life) with each trial."""
    decay = 2 ** (-1 / half_life)
    kept = np.zeros((number, 2))
    for batch in history:
        for n in range(number):
            for failed, _ in trials_of(batch, n):
                kept[n] = decay * kept[n] + [1 - failed, failed]
    return kept


def averages(history, number, half_life, first):
    """Moving averages of failures; they begin at `first`, or with the first trial where it is None."""
    decay = 2 ** (-1 / half_life)
    kept = [first] * number
    for batch in history:
        for n in range(number):
            for failed, _ in trials_of(batch, n):
                kept[n] = failed if kept[n] is None else decay * kept[n] + (1 - decay) * failed
    return kept


def normalized(weights):
    weights = np.asarray(weights, float)
    return weights / weights.sum() if weights.sum() > 0 else np.full(len(weights), 1 / len(weights))


def forgetting(history, number, alpha, half_life):
    return normalized([
        f / (s + f) + alpha if s + f > 0 else 1 for s, f in memories(history, number, half_life)
    ])  # fmt: skip


def failure_ema(history, number, half_life, power):
    return normalized([e**power for e in averages(history, number, half_life, 1.0)])


def learnability(history, number, half_life):
    weights = []
    for s, f in memories(history, number, half_life):
        a, b = s + 1, f + 1
        mean, variance = a / (a + b), a * b / ((a + b) ** 2 * (a + b + 1))
        weights.append(mean - (variance + mean**2))  # E[p] - E[p²]
    return normalized(weights)


def u(p, tries):
    return 1 - (1 - p) ** tries - p


def pass_at_n(history, number, tries, half_life):
    return normalized([
        u((s + 0.5) / (s + f + 1), tries) for s, f in memories(history, number, half_life)
    ])  # fmt: skip


def top_of(scores, best):
    """How much of each is in the best share, by sorting: ties have the same part of what is left."""
    scores, wanted = np.asarray(scores), best * len(scores)
    top, taken = np.zeros(len(scores)), 0.0
    for value in sorted(set(scores), reverse=True):
        same = scores == value
        top[same] = min(1.0, max(0.0, (wanted - taken) / same.sum()))
        taken += same.sum()
    return top


def table_top(history, number, tries, half_life, best, mass):
    scores = [
        np.float32(u((s + 0.5) / (s + f + 1), tries)) for s, f in memories(history, number, half_life)
    ]  # fmt: skip
    return mass * top_of(scores, best) / (best * number) + (1 - mass) / number


def learning_progress(history, number, fast, slow):
    def magnified(p):
        return p * 0.9 / (p + 0.1 * (1 - 2 * p))

    both = [averages(history, number, half_life, None) for half_life in (fast, slow)]
    change = {
        n: abs(magnified(1 - quick) - magnified(1 - late))
        for n, (quick, late) in enumerate(zip(*both, strict=True))
        if quick is not None
    }
    mean, deviation = (np.mean([*change.values()]), np.std([*change.values()])) if change else (0, 0)
    weights = [
        1 / (1 + math.exp(-(change[n] - mean) / max(deviation, 1e-6))) if n in change else 1
        for n in range(number)
    ]
    return normalized(weights)


def nearest_of_the_simplex(point, floor):
    """By the one root of a monotone function."""
    amount = optimize.brentq(
        lambda t: np.maximum(point - t, floor).sum() - 1, point.min() - 2, point.max() + 2, xtol=1e-14
    )
    return np.maximum(point - amount, floor)


def dro(history, number, step, entropy, half_life):
    y = np.full(number, 1 / number)
    for end in range(1, len(history) + 1):
        if not history[end - 1]:
            continue
        e = np.array(averages(history[:end], number, half_life, 1.0))
        slope = e - entropy * (np.log(number * y) + 1)
        y = nearest_of_the_simplex(y + step / number * slope, 0.01 / number)
    return y


def return_of(length, failed):
    """What stands in for an episode's return."""
    return length / 30 - failed


def plr(history, number, replay, staleness, temperature, rank, score_of=lambda signal, best, solved: signal):
    score, last, history = {}, {}, [batch for batch in history if batch]
    for now, batch in enumerate(history):
        for n in range(number):
            for _, signal in trials_of(batch, n)[:1]:
                until_now = [row for batch in history[: now + 1] for row in batch if row[0] == n]
                best = max(return_of(length, failed) for _, failed, length, _ in until_now)
                solved = not all(failed for _, failed, *_ in until_now)
                score[n], last[n] = max(score_of(signal, best, solved), 0.0), now
    if not score:
        return np.full(number, 1 / number)
    seen = sorted(score)
    if rank:
        order = sorted(seen, key=lambda n: (-np.float32(score[n]), n))
        weight = {n: (1 / (order.index(n) + 1)) ** (1 / temperature) for n in seen}
    else:
        weight = {n: score[n] ** (1 / temperature) for n in seen}
    by_score = normalized([weight[n] for n in seen])
    by_age = normalized([len(history) - last[n] for n in seen])
    unseen = number - len(seen)
    chance = replay if unseen else 1.0
    found = np.full(number, (1 - chance) / max(unseen, 1))
    found[seen] = chance * ((1 - staleness) * by_score + staleness * by_age)
    return found


def sfl(history, number, scoring, between, best, mass):
    counts, ended, is_scoring, top = np.zeros((number, 2)), 0, True, None
    for batch in history:
        ended += len(batch)
        if is_scoring:
            for n, failed, *_ in batch:
                counts[n] += [1, failed]
            if ended >= scoring * number:
                trials, failures = counts.T
                p = failures * (trials - failures) / np.maximum(trials, 1) ** 2
                top = top_of(np.where(trials > 0, np.float32(p), -1), best)
                is_scoring, ended = False, 0
        elif ended >= between * number:
            counts, ended, is_scoring = np.zeros((number, 2)), 0, True
    if is_scoring:
        return np.full(number, 1 / number)
    return mass * top / (best * number) + (1 - mass) / number


def per_step(history, number, alpha):
    """PEC's shares (Eq. 1-2), of steps."""
    rows = [row for batch in history for row in batch]
    priority, length = np.ones(number), np.ones(number)
    if rows:
        length[:] = np.mean([row[2] for row in rows])
    for n in range(number):
        own = [row for row in rows if row[0] == n]
        if own:
            priority[n], length[n] = (
                np.mean([row[1] for row in own]) + alpha,
                np.mean([row[2] for row in own]),
            )
    return normalized(normalized(priority) / length)
