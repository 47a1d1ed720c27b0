"""A search over settings: Optuna proposes a learning rate and α, and ends trainings that fall behind.

pip install optuna
python examples/search.py [TRIALS]
"""

import sys

import optuna

import pecjax
from pecjax.runtime.devices import keep_compiled_programs, use_all_cores


def main(trials=8, iterations=60, every=20, base=pecjax.RunSettings()):
    """Trains once for each trial, prints what came out, and returns the Optuna study."""
    base = pecjax.set_path(base, "stop.iterations", iterations)
    base = pecjax.set_path(base, "evaluation.every", every)

    def objective(trial):
        proposed = {
            "agent.learning_rate": trial.suggest_float("learning_rate", 1e-4, 1e-2, log=True),
            "sampler.alpha": trial.suggest_float("alpha", 0.0, 1.0),
        }
        settings = base
        for path, value in proposed.items():
            settings = pecjax.set_path(settings, path, value)

        def report(table, rows):
            """What it raises ends the training."""
            (row,) = rows
            if table == "evaluation" and row["iteration"] < iterations:
                trial.report(row["goal_ratio"], row["iteration"])
                if trial.should_prune():
                    raise optuna.TrialPruned

        result = pecjax.train(settings, sinks=[pecjax.sinks.Callback(report)])
        return result.evaluation[-1]["goal_ratio"]

    study = optuna.create_study(
        direction="maximize",
        sampler=optuna.samplers.TPESampler(seed=0),
        pruner=optuna.pruners.MedianPruner(n_startup_trials=2),
    )
    study.optimize(objective, n_trials=trials)
    for trial in study.trials:
        ended = " (ended early)" if trial.state == optuna.trial.TrialState.PRUNED else ""
        learning_rate, alpha = trial.params["learning_rate"], trial.params["alpha"]
        print(f"learning rate {learning_rate:.1e}, α {alpha:.2f}: goal ratio {trial.value:.3f}{ended}")
    return study


if __name__ == "__main__":
    use_all_cores()
    keep_compiled_programs()
    main(*map(int, sys.argv[1:2]))
