"""The linear models: ARX by least squares, orders p and q by the validation parts."""

from collections.abc import Sequence
from dataclasses import dataclass

from edge.formats.run_file import RecordedRun
from edge.models.arx import FanInput
from edge.models.fit_arx import ArxFit, fit_arx
from training.data.pairs import split_all
from training.models.rollout import START_ROWS

ORDERS = tuple((p, q) for p in (1, 2, 3, 4, 6, 8, START_ROWS) for q in (1, 2, 3, 4, 6))


@dataclass(frozen=True, slots=True)
class LinearSettings:
    """The paper's form (eq. method-arx-equation); with ambient and excess it is the rig's own, see `Arx`."""

    step_s: float = 60.0
    orders: tuple[tuple[int, int], ...] = ORDERS
    fan_input: FanInput = "on"
    with_ambient: bool = False


WITH_AMBIENT = LinearSettings(fan_input="excess", with_ambient=True)


def train(runs: Sequence[RecordedRun], settings: LinearSettings) -> ArxFit:
    """Fit the model on the training parts, its orders chosen on the validation parts.

    Errors : DataError for a test run
    """
    parts = split_all(runs)
    return fit_arx(
        parts.train,
        parts.validate,
        settings.step_s,
        settings.orders,
        settings.fan_input,
        settings.with_ambient,
    )
