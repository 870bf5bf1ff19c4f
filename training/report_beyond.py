"""What our own models show beside the paper's, in figures."""

from collections.abc import Sequence

import numpy as np

from training.report_tables import Evaluation, regime_means, spread
from training.scores import Score
from training.study import SCENARIOS
from training.trained import UNGUARDED

IN, OUT = SCENARIOS  # the two regimes


def beyond(found: Evaluation) -> list[str]:
    """What our own models show, a paragraph each."""
    scores = found.scores
    best, paper, lstm = (regime_means(scores, model, OUT) for model in ("ham_guarded", "ham", "lstm"))
    twin, free = regime_means(scores, "twin", OUT), regime_means(scores, UNGUARDED, OUT)
    wins = sum(int(best.max() < min(a, b)) for a, b in zip(paper, lstm, strict=True))
    room_in, room_out = (regime_means(scores, "linear_ambient", regime) for regime in (IN, OUT))
    steps_in, steps_out = (regime_means(scores, "lstm_increment", regime) for regime in (IN, OUT))
    bias = [_bias(scores, "twin", number) for numbers in SCENARIOS.values() for number in numbers]
    return [
        f"HAM over the fitted twin, guarded: extrapolation {spread(best)} K, the paper's HAM {spread(paper)} "
        f"K, the LSTM {spread(lstm)} K. Its worst seed is better than both in {wins} of {len(paper)} seeds. "
        "Outside the box of its training data the correction fades to 0 over half a kelvin, and what remains "
        "is the twin: loss, capacity, heater lag and walls, fitted on the training runs.",
        f"Most of that gain is the fitted twin's: alone it has {spread(twin)} K in extrapolation and "
        f"{spread(regime_means(scores, 'twin', IN))} K in interpolation (the hybrid: "
        f"{spread(regime_means(scores, 'ham_guarded', IN))} K). The network over it has little left to "
        "learn.",
        f"The guard does what it is for and no more: with it off the same weights have {spread(free)} K in "
        "extrapolation, worse than the twin without any correction, and the same as before in interpolation, "
        "where no test run leaves the box by much.",
        f"The linear model with the room temperature and the fan by the excess it carries away: "
        f"{spread(room_in)} K in interpolation (Linear {spread(regime_means(scores, 'linear', IN))} K), "
        f"{spread(room_out)} K in extrapolation (Linear {spread(regime_means(scores, 'linear', OUT))} K). "
        "The right inputs pay where the temperature is new; in interpolation its bias is all of its error.",
        f"An LSTM that gives the increment: {spread(steps_in)} K in interpolation, {spread(steps_out)} K in "
        "extrapolation. Increments don't saturate, so it leaves the training range; but their errors add up.",
        "The twin's bias by scenario, "
        + ", ".join(f"{value:+.2f}" for value in bias)
        + " K, is mostly the test board's own: its mains voltage, draught and sensors differ from run to run "
        "(chamber.yaml), and no model knows them beforehand.",
    ]


def _bias(scores: Sequence[Score], model: str, scenario: int) -> float:
    mine = [s.free_run.bias_k for s in scores if s.model == model and s.scenario == scenario]
    return float(np.mean(mine))
