"""Which effects the training runs can't tell from a hidden one: set by the scorer, never by the workflow.

The true structure (what the twin file declares and all hidden effects) is fitted by maximum likelihood, and
so is each structure in which one hidden effect is replaced by another of the library, its noise as well as
its values. A rival of more parameters than the effect pays 1/2 log n for each (Schwarz 1978), or a wall that
stores heat would stand for every wall that does not; one of fewer gets nothing. A member of the effect's
class is at most ALIAS_NATS behind the truth, at most BETTER_NATS ahead of it (by chance; what fits better by
more mends something else), and gains ALIAS_NATS over nothing in the effect's place. Where the effect itself
gains less, nothing can stand for it. Rows further than OUTLIER_SD from the true fit are left out. An effect
whose column the runs don't have (`door_open`: when the door was open) is no rival, and as a hidden effect has
none.
"""

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.hidden_effects.cases import HiddenEffect, Truth
from bench.hidden_effects.score_fit import LikelihoodFit, fit
from bench.hidden_effects.score_noise import ReadingNoise
from bench.hidden_effects.score_rivals import sieve, unknown
from bench.hidden_effects.score_structure import Structure, structure
from edge.formats.run_file import RecordedRun
from edge.twin.effects.further import FURTHER_EFFECTS
from edge.twin.effects.library import EFFECTS, USUAL_EFFECTS, acting_effects
from edge.twin.run_batch import RunBatch, batch_runs
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value

Floats = NDArray[np.float64]
METHOD_VERSION = 4  # classes of another version are computed anew
ALIAS_NATS = 3.0
BETTER_NATS = 6.0  # by which a rival is ahead in one case of exp(6) = 400 at most
KEPT_NATS = 10.0  # rivals further behind are not written down
SECOND_LOOK_NATS = 20.0  # rivals further behind after one pass get no second
OUTLIER_SD = 6.0
_TRUTH_PASSES = 6
_FIRST_NOISE = ReadingNoise(0.1, 0.1, 20.0)
_WITHOUT_A_COLUMN = ("door_opening",)  # the runs don't say when the door was open


@dataclass(frozen=True, slots=True)
class AliasClass:
    """The effects that a hidden effect cannot be told from.

    behind : nats by which each rival fits worse than the truth, KEPT_NATS at most; below 0 it fits better
    gain_nats : of the effect over nothing in its place; None where that can't be told
    """

    effect: str
    behind: Mapping[str, float] = field(default_factory=dict)
    gain_nats: float | None = None

    @property
    def members(self) -> frozenset[str]:
        """As near as that, the effect itself among them."""
        return self.within(ALIAS_NATS)

    def within(self, nats: float) -> frozenset[str]:
        """Those at most so far behind the truth."""
        near = (name for name, behind in self.behind.items() if -BETTER_NATS <= behind <= nats)
        return frozenset({self.effect, *near})

    def up_to(self, nats: float) -> frozenset[str]:
        """Return the class with rivals that fit better than the truth by up to `nats`."""
        return self.within(nats) | {name for name, behind in self.behind.items() if behind <= nats}

    @property
    def shows(self) -> bool:
        """True if the runs show at all that something is missing."""
        return self.gain_nats is None or self.gain_nats >= ALIAS_NATS


def alias_classes(truth: Truth, file: TwinFile, runs: Sequence[RecordedRun]) -> tuple[AliasClass, ...]:
    """Return the class of each hidden effect of a case, in the truth's
    order. Errors: DataError as of `batch_runs`
    """
    if all(item.name in _WITHOUT_A_COLUMN for item in truth.hidden):
        return tuple(AliasClass(item.name) for item in truth.hidden)
    data = batch_runs(runs, file.sample_s)
    mains_sd, curve = (truth.noise.get(key, 0.0) for key in ("heater_power_run_sd", "ua_curve_per_10_k"))
    whole = structure(_with(file, truth.hidden), data, mains_sd, curve)
    found = fit(whole, whole.start, _FIRST_NOISE, passes=1)
    whole = structure(whole.file, _without_outliers(whole, found), mains_sd, curve)
    found = fit(whole, found.scaled, found.noise, _TRUTH_PASSES)
    return tuple(_class(item, whole, found) for item in truth.hidden)


def _without_outliers(truth: Structure, found: LikelihoodFit) -> RunBatch:
    residual = truth.residual(found.scaled)
    usual = 1.4826 * np.median(np.abs(residual[truth.measured]))  # sd of a normal distribution
    temp = truth.data.temp.copy()
    temp[:, 1:][np.abs(residual) > OUTLIER_SD * usual] = np.nan
    return replace(truth.data, temp=temp)


def _class(hidden: HiddenEffect, truth: Structure, found: LikelihoodFit) -> AliasClass:
    if hidden.name in _WITHOUT_A_COLUMN:
        return AliasClass(hidden.name)
    nothing = _fit_near(truth.other(_others(truth, hidden.name)), {}, truth, found)
    gain = found.log_likelihood - nothing
    behind: dict[str, float] = {}
    if gain >= ALIAS_NATS:
        sifted = sieve(truth, found, hidden.name)
        for name in _rivals(hidden.name, truth.file, truth.data):
            own = sifted.start_of(name)
            if own is None:
                continue
            rival = truth.other({**_others(truth, hidden.name), name: unknown(name, truth.file)})
            reached = _fit_near(rival, dict(zip(_places(name), own, strict=True)), truth, found)
            nats = found.log_likelihood - reached + _price(name, hidden.name, truth)
            if nats <= KEPT_NATS and reached - nothing >= ALIAS_NATS:
                behind[name] = nats
    return AliasClass(hidden.name, behind, gain)


def _others(truth: Structure, hidden: str) -> dict[str, Mapping[str, Value]]:
    return {key: own for key, own in truth.file.effects.items() if key != hidden}


def _places(name: str) -> list[Place]:
    return [("effects", name, item.name) for item in EFFECTS[name].parameters]


def _fit_near(rival: Structure, own: Mapping[Place, float], truth: Structure, found: LikelihoodFit) -> float:
    """Log likelihood of a structure, begun at its own scaled parameters and the true fit of the others."""
    others = truth.values(found.scaled)
    begun = [
        own[item.place] if item.place in own else item.scale(others.get(item.place, item.start))
        for item in rival.unknowns
    ]
    once = fit(rival, np.array(begun), found.noise, passes=1)
    if found.log_likelihood - once.log_likelihood > SECOND_LOOK_NATS:
        return once.log_likelihood
    return max(once.log_likelihood, fit(rival, once.scaled, once.noise, passes=1).log_likelihood)


def _price(rival: str, hidden: str, truth: Structure) -> float:
    """Return the penalty of the rival's further parameters [nats]."""
    more = len(EFFECTS[rival].parameters) - len(EFFECTS[hidden].parameters)
    return max(0, more) * 0.5 * float(np.log(truth.measured.sum()))


def _rivals(hidden: str, file: TwinFile, data: RunBatch) -> Iterator[str]:
    """Effects that could stand in the place of a hidden one: not there, with their columns, and acting."""
    for name, effect in {**USUAL_EFFECTS, **FURTHER_EFFECTS}.items():
        missing = [column for column in effect.needs if column not in data.conditions]
        if name in file.effects or name in _WITHOUT_A_COLUMN or missing:
            continue
        if name in acting_effects([*(key for key in file.effects if key != hidden), name]):
            yield name


def _with(file: TwinFile, hidden: tuple[HiddenEffect, ...]) -> TwinFile:
    known = [item for item in hidden if item.name not in _WITHOUT_A_COLUMN]
    added = {item.name: unknown(item.name, file, item.parameters) for item in known}
    return replace(file, effects={**file.effects, **added})


def cached_classes(
    cache: Path, key: str, truth: Truth, file: TwinFile, runs: Sequence[RecordedRun]
) -> tuple[AliasClass, ...]:
    """Return the classes cached for this key, else compute them and write them to `cache`."""
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
        "classes": [asdict(item) for item in classes],
    }
    cache.parent.mkdir(parents=True, exist_ok=True)
    cache.write_text(json.dumps(document) + "\n", encoding="utf-8")
    return classes
