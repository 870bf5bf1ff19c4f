"""The physics-based models: the paper's, which has nothing to fit, and the twin whose effects are fitted."""

from collections.abc import Sequence
from dataclasses import dataclass

from edge.formats.run_file import RecordedRun
from edge.twin.effects.library import EFFECTS
from edge.twin.fit import fit_twin
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from training.data.pairs import split_all


@dataclass(frozen=True, slots=True)
class PbmSettings:
    """The paper's form (eq. pbm): no effects, nothing fitted."""

    step_s: float = 60.0
    effects: tuple[str, ...] = ()  # of `edge.twin.effects.library.EFFECTS`, each with its usual start


# The paper's one mass, with what it needs to be of the right size: capacity, loss and the fan's share.
ONE_MASS = PbmSettings(effects=("extra_capacity", "wall_loss", "fan_effectiveness"))
# Loss and capacity, and what a one-state box can't hold: the element's lag and the walls' memory.
FITTED = PbmSettings(effects=("extra_capacity", "wall_mass", "heater_lag", "fan_effectiveness"))


def train(runs: Sequence[RecordedRun], settings: PbmSettings) -> TwinFile:
    """Fit the twin's effects on the training parts of `runs`.

    Errors : DataError for a test run
    """
    effects = {
        name: {item.name: Value(item.start, fit=True) for item in EFFECTS[name].parameters}
        for name in settings.effects
    }
    file = TwinFile(sample_s=settings.step_s, effects=effects)
    return fit_twin(file, split_all(runs).train).file if effects else file
