"""What our own models show beside the paper's, in figures."""

import numpy as np

from training.models.study import SCENARIOS
from training.models.trained import UNGUARDED
from training.reports.report_tables import Evaluation, regime_means, spread

IN, OUT = SCENARIOS  # the two regimes


def beyond(found: Evaluation) -> list[str]:
    """What our own models show, a paragraph each."""
    scores = found.scores
    best, paper, lstm = (regime_means(scores, model, OUT) for model in ("ham_guarded", "ham", "lstm"))
    twin, free = regime_means(scores, "twin", OUT), regime_means(scores, UNGUARDED, OUT)
    wins = sum(int(best.max() < min(a, b)) for a, b in zip(paper, lstm, strict=True))
    room_in, room_out = (regime_means(scores, "linear_ambient", regime) for regime in (IN, OUT))
    steps_in, steps_out = (regime_means(scores, "lstm_increment", regime) for regime in (IN, OUT))
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
        "where the test runs stay in the box.",
        f"The linear model with the room temperature and the fan by the excess it carries away: "
        f"{spread(room_in)} K in interpolation (Linear {spread(regime_means(scores, 'linear', IN))} K), "
        f"{spread(room_out)} K in extrapolation (Linear {spread(regime_means(scores, 'linear', OUT))} K). "
        "The right inputs pay where the temperature is new; in interpolation its bias is all of its error.",
        f"An LSTM that gives the increment: {spread(steps_in)} K in interpolation, {spread(steps_out)} K in "
        "extrapolation. Increments don't saturate, so it leaves the training range; but their errors add up.",
        _hot_fit(found),
    ]


def _hot_fit(found: Evaluation) -> str:
    """Why models with the right inputs do better in what is called extrapolation."""
    low = next(row for row in found.swapped if row.regime == OUT)
    all_runs = next(row for row in found.swapped if row.regime == IN)
    apart = np.mean(low.bias_k) - np.mean(all_runs.bias_k)
    cool = next(row for row in found.by_excess if row.regime == OUT)
    every = next(row for row in found.by_excess if row.regime == IN)
    return (
        "Twin, hybrid and the linear model with the room are better in extrapolation than in interpolation. "
        "It is not the runs: over the same six test runs the twin fitted on all training runs is "
        f"{apart:.2f} K colder than the one fitted on the cool ones (bias {np.mean(all_runs.bias_k):+.2f} "
        f"and {np.mean(low.bias_k):+.2f} K). On the training runs the latter is {cool.bias_k[0]:+.2f} K off "
        f"near the room's temperature and {cool.bias_k[-1]:+.2f} K where the air is 12 to 15 K over it: the "
        "box loses more than in proportion to its excess (radiation and free convection, CHAMBER.md), the "
        f"twin's losses are linear. Fitted on all runs it splits the difference, {every.bias_k[1]:+.2f} K at "
        "3 to 6 K. What is left differs from run to run: mains voltage, draught and sensors of each board "
        "are drawn anew, and no model knows them beforehand."
    )
