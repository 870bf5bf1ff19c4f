"""Limits of the recordings that no computation removes, stated before anything is fitted."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.report.wording import join_names
from edge.formats.run_file import RecordedRun
from edge.twin.effects.effect import BlindRuns
from edge.twin.effects.library import hidden_by

SMALL_EXCESS_K = 2.0  # air over room: less, and losses drown in noise
STEADY_ROOM_K = 0.5
SHORT_S = 3600.0  # walls and soil answer over hours
DAY_S = 86400.0
FARTHER_K, FARTHER_SHARE = 5.0, 0.1  # than the training runs went: kelvins, or share of their range if more
MORE_DUTY = 0.1
WHAT = {"temp_air_c": "the air", "temp_ambient_c": "the room"}

Floats = NDArray[np.float64]


def cannot_tell(
    runs: Sequence[RecordedRun], tests: Mapping[str, RecordedRun], sources: int
) -> tuple[str, ...]:
    """Sentences.

    runs : what is fitted on, at least one; tests : what is judged by, by name
    sources : recordings that they come from
    """
    found = [*_trials(bool(tests), sources), *_heater(runs), *_fan(runs), *_room(runs), *_rest(runs)]
    return (*found, *(text for name, test in tests.items() for text in _beyond(name, test, runs)))


def _beyond(name: str, test: RecordedRun, runs: Sequence[RecordedRun]) -> Iterable[str]:
    """Yield the conditions of a test run that no training run covers: its
    error says less about the missing effect.
    """
    ran, runs_now = (_levels(own, "fan_on") or {0.0} for own in (runs, [test]))
    if max(ran) == 0.0 < max(runs_now):
        yield f"{name} is in another regime: the fan runs there, in no training run"
    elif min(ran) > 0.0 == min(runs_now):
        yield f"{name} is in another regime: the fan stands still there, in no training run"
    duty, known_duty = (max(_levels(own, "heater_duty"), default=0.0) for own in ([test], runs))
    if duty > known_duty + MORE_DUTY:
        yield (
            f"{name} is in another regime: the heater goes up to {100.0 * duty:.0f} % there, to "
            f"{100.0 * known_duty:.0f} % in the training runs"
        )
    for key, what in WHAT.items():
        own, known = _known_values(test, key), np.concatenate([_known_values(run, key) for run in runs])
        if not len(own) or not len(known):
            continue
        # A little beyond is no other regime: the margin grows with what the training runs span.
        by_k = max(FARTHER_K, FARTHER_SHARE * float(np.ptp(known)))
        for off_k, word, reached in (
            (own.max() - known.max(), "warmer", known.max()),
            (known.min() - own.min(), "colder", known.min()),
        ):
            if off_k > by_k:
                yield (
                    f"{name} is in another regime: {what} gets {off_k:.3g} K {word} there than the "
                    f"{reached:.3g} degC of the training runs"
                )


def _trials(has_test: bool, sources: int) -> Iterable[str]:
    if sources == 1:
        yield (
            "there is one training run: nothing tells a choice that holds from one that fits this run alone; "
            "record more, from other starts"
        )
    if not has_test:
        yield "there is no test run: nothing shows the gap on data that had no part in the choice"


def _heater(runs: Sequence[RecordedRun]) -> Iterable[str]:
    levels = _levels(runs, "heater_duty")
    if not any(level > 0.0 for level in levels):
        yield "the heater never heats: no effect of the heater, and no scale of the heat, can be told"
    elif not _moves(runs, "heater_duty"):
        yield f"the heater never changes: {_names(BlindRuns.HEATER_STEADY)} can't be told"
    elif len([level for level in levels if level > 0.0]) == 1:
        yield (
            f"the heater knows only off and one level: {_names(BlindRuns.HEATER_ONE_LEVEL)} "
            "look the same; a staircase of levels tells them apart"
        )


def _fan(runs: Sequence[RecordedRun]) -> Iterable[str]:
    levels = _levels(runs, "fan_on")
    if _moves(runs, "fan_on"):
        return
    if levels <= {0.0}:
        recorded = any("fan_on" in run.columns for run in runs)
        yield (
            f"the fan {'never runs' if recorded else 'was not recorded and counts as still'}: "
            f"its effects can't be told, and {_alike(BlindRuns.FAN_OFF)}"
        )
    else:
        yield (
            f"the fan never changes: {_names(BlindRuns.FAN_STEADY)} can't be told, "
            "and what it takes out looks like a loss through the walls"
        )


def _room(runs: Sequence[RecordedRun]) -> Iterable[str]:
    rooms = [known for run in runs if len(known := _known_values(run, "temp_ambient_c"))]
    if not rooms:
        yield (
            "the room temperature was not recorded and is fitted as a constant: "
            f"{_names(BlindRuns.ROOM_UNKNOWN)} can't be told apart"
        )
        return
    together = np.concatenate(rooms)
    if np.ptp(together) < STEADY_ROOM_K:
        yield (
            f"the room stayed within {np.ptp(together):.1f} K: {_names(BlindRuns.ROOM_STEADY)} "
            f"look much the same, and so do {_names(BlindRuns.ROOM_STEADY_BODIES)}"
        )
    measured = [run.columns for run in runs if "temp_ambient_c" in run.columns]
    excess = [columns["temp_air_c"] - columns["temp_ambient_c"] for columns in measured]
    highest = np.nanmax(np.abs(np.concatenate(excess)), initial=0.0)
    if highest < SMALL_EXCESS_K:
        yield f"the air was never more than {highest:.1f} K from the room: losses can hardly be told"


def _rest(runs: Sequence[RecordedRun]) -> Iterable[str]:
    if max(float(run.columns["time_s"][-1]) for run in runs) < SHORT_S:
        bodies = hidden_by(BlindRuns.SHORT)
        others = join_names(list(dict.fromkeys(bodies.values())))
        yield f"no run lasts an hour: slow bodies ({', '.join(bodies)}) can hardly be told from {others}"
    if not _moves(runs, "light"):
        why = "never changes" if _levels(runs, "light") else "was not recorded"
        yield f"the light {why}: {_names(BlindRuns.LIGHT_STEADY)} can't be told"
    if not any(len(_known_values(run, "rel_humidity_pct")) for run in runs):
        yield f"the humidity was not recorded: {_names(BlindRuns.HUMIDITY_UNKNOWN)} can't be told"
    starts = [run.start_utc for run in runs]
    known = [start for start in starts if start is not None]
    if len(known) < len(starts):
        names = _names(BlindRuns.START_UNKNOWN)
        yield f"not every run says when it began (start_utc): {names} and the time of day can't be told"
    elif max(known) - min(known) < DAY_S:
        yield f"the runs began within one day: {_names(BlindRuns.ONE_DAY)} can hardly be told"


def _names(runs: BlindRuns) -> str:
    return join_names(list(hidden_by(runs)))


def _alike(runs: BlindRuns) -> str:
    """Each effect and the one that it looks like."""
    return join_names([f"{name} looks like {other}" for name, other in hidden_by(runs).items()])


def _levels(runs: Sequence[RecordedRun], key: str) -> set[float]:
    return {float(value) for run in runs for value in np.unique(_known_values(run, key))}


def _moves(runs: Sequence[RecordedRun], key: str) -> bool:
    """Return whether a column changes within a run. Between runs, much else changes too."""
    return any(np.ptp(known) > 0.0 for run in runs if len(known := _known_values(run, key)))


def _known_values(run: RecordedRun, key: str) -> Floats:
    values = run.columns.get(key, np.empty(0))
    return values[np.isfinite(values)]
