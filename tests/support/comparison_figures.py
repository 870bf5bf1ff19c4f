"""Made-up figures of a comparison, for tests of what is done with them."""

import numpy as np

from training.data.datasets import test_run as run_of
from training.evaluate.ablation import Base, ByExcess, UnexplainedError
from training.evaluate.report import MODELS, Evaluation
from training.evaluate.resources import ModelCost
from training.evaluate.scores import ScoredRun, SwappedModel, TrainingScore
from training.models.rollout import START_ROWS, RolloutErrors
from training.models.study import SCENARIOS, Regime

SEEDED = ("lstm", "ham", "lstm_increment", "ham_guarded", "ham_unguarded")
MISSED_K = {"linear": 1.0, "pbm": 100.0, "lstm": 0.5, "ham": 2.0, "linear_ambient": 0.7, "twin": 0.3,
            "pbm_fitted": 1.2, "lstm_increment": 0.9, "ham_guarded": 0.2, "ham_unguarded": 0.25}  # fmt: skip


def score(model: str, regime: Regime, seed: int, scenario: int, mae_k: float) -> TrainingScore:
    missed = RolloutErrors(mae_k, mae_k, mae_k, mae_k, 1)
    return TrainingScore(model, regime, seed, scenario, missed, missed, mae_k, mae_k, 0.5, 30.0, 31.0)


def all_scored(seeds: int = 2) -> list[ScoredRun]:
    """Every model misses every measurement by MISSED_K, a little more with each seed."""
    found = []
    for model in MODELS:
        for regime, numbers in SCENARIOS.items():
            for seed in range(seeds if model in SEEDED else 1):
                for number in numbers:
                    missed = MISSED_K[model] * (1.0 + 0.01 * seed)
                    forecast = run_of(number).columns["temp_air_c"][START_ROWS:] + missed
                    found.append(ScoredRun(score(model, regime, seed, number, missed), np.asarray(forecast)))
    return found


def evaluation(found: list[ScoredRun]) -> Evaluation:
    return Evaluation(
        tuple(one.score for one in found),
        tuple(UnexplainedError(name, 0.5, 0.4) for name in ("room, heater", "+ air", "+ duties")),
        tuple(Base(name, 1, 1.0, (0.9, 0.8)) for name in ("bare", "loss", "lag", "walls")),
        (
            SwappedModel("twin", "interpolation", (-0.3,) * 6),
            SwappedModel("twin", "extrapolation", (0.0,) * 6),
        ),
        (ByExcess("interpolation", (-0.1,) * 5), ByExcess("extrapolation", (0.1,) * 5)),
    )


def costs() -> list[ModelCost]:
    models = [model for model in MODELS if model != "ham_unguarded"]
    return [
        ModelCost(model, i + 0.5, 300, 10, 20.0 + i, 30, 27, 31, 32, 0.1, 1, 2)
        for i, model in enumerate(models)
    ]
