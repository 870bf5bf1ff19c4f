"""Candidates for the missing effect, and the penalty for naming each.

Each value found costs half log(rows) (BIC, Schwarz 1978) and each effect chosen among others log(candidates)
(Chen & Chen 2008, Biometrika 95: the extended BIC), so that the chance that any of the candidates is named
by luck stays small however many are tried. A door that was found in the runs was chosen among all places.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from edge.diagnosis.trial import FittedTwin, SizedTerm
from edge.twin.effects.library import EFFECTS, USUAL_EFFECTS
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import TwinFile

Names = frozenset[str]
DOOR_LENGTHS = 6.0  # among which that of a door was chosen, as if they had nothing in common
DOOR = "door_open"  # the column that doors found in the runs become
FORMULA_NATS = 4.0  # by which a formula must be better than a name


@dataclass(frozen=True, slots=True, eq=False)
class ScoredSet:
    """A set of effects beside those that were known, at its best.

    likelihood : nats, noise levels' prior included; score : less the penalty
    """

    added: Names
    fit: FittedTwin
    likelihood: float
    score: float


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Named effects and formulas that a twin may lack, over one lot of runs.

    doors : how many were found in the runs, each where it explains most
    """

    file: TwinFile
    runs: RunBatch
    formulas: Mapping[str, SizedTerm]
    doors: int = 0

    @property
    def names(self) -> list[str]:
        """The usual effects that are not there and have their columns."""
        have, known = set(self.runs.conditions), self.file.effects
        useless = {*known, *(EFFECTS[name].replaces for name in known)}
        return [
            name
            for name, effect in USUAL_EFFECTS.items()
            if name not in useless
            and {*effect.needs, *effect.offered_with} <= have
            and (self.file.fan_role == "exhaust" or not effect.by_flow)
        ]

    @property
    def rows(self) -> int:
        """Temperatures that are fitted to."""
        return int(self.runs.measured.sum())

    def penalty(self, name: str) -> float:
        """Return the penalty for naming an effect or a formula [nats]."""
        if name in self.formulas:
            return 0.5 * float(np.log(self.rows)) + float(np.log(len(self.formulas))) + FORMULA_NATS
        effect = EFFECTS[name]
        values = len(effect.parameters)
        if effect.amounts_to is not None and effect.replaces in self.file.effects:
            values -= len(EFFECTS[effect.replaces].parameters)  # known, as its own amount to them
        chosen = float(np.log(len(self.names)))
        if DOOR in effect.offered_with:
            chosen += self.doors * float(np.log(DOOR_LENGTHS * self.runs.duty.shape[1]))
        return 0.5 * values * float(np.log(self.rows)) + chosen
