"""Which effects the training runs can't tell from a hidden one: set by the scorer, never by the workflow.

The true structure (what the twin file declares and all hidden effects) is fitted by maximum likelihood, and
so is each structure in which one hidden effect is replaced by another of the library, its noise as well as
its values. A rival of more parameters than the effect pays 1/2 log n for each (Schwarz 1978), or a wall that
stores heat would stand for every wall that does not; one of fewer gets nothing. A member of the effect's
class is within ALIAS_NATS of the truth, or better. An effect whose column the runs don't have (`door_open`:
when the door was open) is no rival, and as a hidden effect has none.
"""

import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.hidden_effects.cases import Hidden, Truth
from bench.hidden_effects.score_noise import Noise
from bench.hidden_effects.score_rivals import sieve, unknown
from bench.hidden_effects.score_structure import Fit, Structure, fit, structure
from edge.run_file import Run
from edge.twin.effects import EFFECTS, applied
from edge.twin.recorded import Recorded, recorded
from edge.twin.twin_file import TwinFile

Floats = NDArray[np.float64]
METHOD_VERSION = 1  # classes of another version are computed anew
ALIAS_NATS = 3.0
KEPT_NATS = 10.0  # rivals further behind are not written down
SECOND_LOOK_NATS = 20.0  # rivals further behind after one pass get no second
_TRUTH_PASSES = 3
_FIRST_NOISE = Noise(0.1, 0.1, 20.0)
_WITHOUT_A_COLUMN = ("door_opening",)  # the runs don't say when the door was open


@dataclass(frozen=True, slots=True)
class AliasClass:
    """What a hidden effect can't be told from.

    behind : nats by which each rival fits worse than the truth, KEPT_NATS at most; the effect itself at 0
    """

    effect: str
    behind: Mapping[str, float]

    @property
    def members(self) -> frozenset[str]:
        """Within ALIAS_NATS, the effect itself among them."""
        return self.within(ALIAS_NATS)

    def within(self, nats: float) -> frozenset[str]:
        return frozenset({self.effect, *(name for name, behind in self.behind.items() if behind <= nats)})


def alias_classes(truth: Truth, file: TwinFile, runs: list[Run]) -> tuple[AliasClass, ...]:
    """The class of each hidden effect of a case, in the truth's order. Errors: DataError as of `recorded`."""
    names = [item.name for item in truth.hidden]
    if not set(names) - set(_WITHOUT_A_COLUMN):
        return tuple(AliasClass(name, {}) for name in names)
    data = recorded(runs, file.sample_s)
    whole = structure(_with(file, truth.hidden), data)
    found = fit(whole, whole.start, _FIRST_NOISE, _TRUTH_PASSES)
    return tuple(_class(item, whole, found) for item in truth.hidden)


def _class(hidden: Hidden, truth: Structure, found: Fit) -> AliasClass:
    if hidden.name in _WITHOUT_A_COLUMN:
        return AliasClass(hidden.name, {})
    sifted = sieve(truth, found, hidden.name)
    behind = {}
    for name in _rivals(hidden.name, truth.file, truth.data):
        start = sifted.start_of(name)
        if start is None:
            continue
        nats = _behind(name, start, truth, found, hidden.name)
        if nats <= KEPT_NATS:
            behind[name] = nats
    return AliasClass(hidden.name, behind)


def _price(rival: str, hidden: str, truth: Structure) -> float:
    """Of the rival's further parameters [nats]."""
    more = len(EFFECTS[rival].parameters) - len(EFFECTS[hidden].parameters)
    return max(0, more) * 0.5 * float(np.log(truth.measured.sum()))


def _behind(name: str, start: Floats, truth: Structure, found: Fit, hidden: str) -> float:
    """Nats by which the rival `name` fits worse, begun at its best place in the sieve and the others' fit."""
    effects = {key: own for key, own in truth.file.effects.items() if key != hidden}
    file = replace(truth.file, effects={**effects, name: unknown(name, truth.file)})
    rival = structure(file, truth.data)
    others = truth.values(found.scaled)
    own = iter(start)
    begun = [
        next(own) if item.place[:2] == ("effects", name) else item.scaled(others.get(item.place, item.start))
        for item in rival.unknowns
    ]
    once = fit(rival, np.array(begun), found.noise, passes=1)
    if found.log_likelihood - once.log_likelihood > SECOND_LOOK_NATS:
        return np.inf
    again = fit(rival, once.scaled, once.noise, passes=1)
    best = max(once.log_likelihood, again.log_likelihood)
    return found.log_likelihood - best + _price(name, hidden, truth)


def _rivals(hidden: str, file: TwinFile, data: Recorded) -> Iterator[str]:
    """Effects that could stand in the place of a hidden one: not there, with their columns, and acting."""
    for name, effect in EFFECTS.items():
        missing = [column for column in effect.needs if column not in data.conditions]
        if name in file.effects or name in _WITHOUT_A_COLUMN or missing:
            continue
        if name in applied([*(key for key in file.effects if key != hidden), name]):
            yield name


def _with(file: TwinFile, hidden: tuple[Hidden, ...]) -> TwinFile:
    known = [item for item in hidden if item.name not in _WITHOUT_A_COLUMN]
    added = {item.name: unknown(item.name, file, item.parameters) for item in known}
    return replace(file, effects={**file.effects, **added})


def cached_classes(
    cache: Path, key: str, truth: Truth, file: TwinFile, runs: list[Run]
) -> tuple[AliasClass, ...]:
    """The classes as they were once computed for this key, else computed and written to `cache`."""
    key = f"{METHOD_VERSION}:{key}"
    if cache.exists():
        document = json.loads(cache.read_text(encoding="utf-8"))
        if document["key"] == key:
            return tuple(AliasClass(**item) for item in document["classes"])
    begun_s = time.process_time()
    classes = alias_classes(truth, file, runs)
    document = {
        "key": key,
        "seconds": time.process_time() - begun_s,
        "classes": [{"effect": item.effect, "behind": dict(item.behind)} for item in classes],
    }
    cache.parent.mkdir(parents=True, exist_ok=True)
    cache.write_text(json.dumps(document) + "\n", encoding="utf-8")
    return classes
