"""What may be missing from a twin, and what it costs to name it.

Each value found costs half log(rows) (BIC, Schwarz 1978) and each effect chosen among others log(candidates)
(Chen & Chen 2008, Biometrika 95: the extended BIC), so that the chance that any of the candidates is named
by luck stays small however many are tried. A door that was found in the runs was chosen among all places.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from edge.diagnosis.trial import Fitted, SizedTerm
from edge.twin.effects.library import EFFECTS, USUAL_EFFECTS
from edge.twin.recorded import Recorded
from edge.twin.twin_file import TwinFile

Names = frozenset[str]
DOOR_LENGTHS = 6.0  # among which that of a door was chosen, as if they had nothing in common
# Of a fan that changes the air: where it stirs, or is none, they do nothing.
BY_FLOW = ("infiltration", "fan_effectiveness", "short_circuit", "fan_deadtime", "fan_spinup")
FORMULA_NATS = 4.0  # by which a formula must be better than a name


@dataclass(frozen=True, slots=True, eq=False)
class ScoredSet:
    """A set of effects beside those that were known, at its best.

    likelihood : nats, noise levels' prior included; score : less the penalty
    """

    added: Names
    fitted: Fitted
    likelihood: float
    score: float


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Named effects and formulas that a twin may lack, over one lot of runs.

    doors : how many were found in the runs, each where it explains most
    """

    file: TwinFile
    runs: Recorded
    formulas: Mapping[str, SizedTerm]
    doors: int = 0

    @property
    def names(self) -> list[str]:
        """The usual effects that are not there and have their columns."""
        have = set(self.runs.conditions)
        return [
            name
            for name, effect in USUAL_EFFECTS.items()
            if name not in self.file.effects and set(effect.needs) <= have and self._can_be(name)
        ]

    def _can_be(self, name: str) -> bool:
        if name == "door_opening":
            return "door_open" in self.runs.conditions
        if name in BY_FLOW and self.file.fan_role != "exhaust":
            return False
        return not (name == "wall_loss" and "wall_mass" in self.file.effects)

    @property
    def rows(self) -> int:
        """Temperatures that are fitted to."""
        return int(self.runs.measured.sum())

    def penalty(self, name: str) -> float:
        """Of naming an effect, or of a formula [nats]."""
        if name in self.formulas:
            return 0.5 * float(np.log(self.rows)) + float(np.log(len(self.formulas))) + FORMULA_NATS
        values = len(EFFECTS[name].parameters)
        if name == "wall_mass" and "wall_loss" in self.file.effects:
            values -= 1  # what its films give in series is known
        chosen = float(np.log(len(self.names)))
        if name == "door_opening":
            chosen += self.doors * float(np.log(DOOR_LENGTHS * self.runs.duty.shape[1]))
        return 0.5 * values * float(np.log(self.rows)) + chosen
