"""python -m bench.hidden_effects score: all answers of a suite and split, from files to figures.

Figures, each with a 95 % interval (Wilson) where it is a share. A case without an answer is wrong in all of
them; on a null it is a false alarm.

naming : first name true, single effects; exact_single, exact_pair : all found and nothing else named
weak, hard : first name true; bare_found, bare_true : of all hidden effects, of all names
found_shown, bare_found_shown : of the effects that the runs show at all (`score_aliases`): those of kinds
single, pair, weak and hard, and of bare; shown : how many they are
false_alarms : nulls with a verdict other than nothing_missing
unknown, dependence : of cases outside the library; of those whose effect depends on something
unknown_wrongly : unknown said of a null or of a hidden effect of the library
told, told_rivals : alias class told honestly, over hidden effects of all kinds that the runs show; of those
with rivals
coverage : of parameters; shrink : cases whose gap shrank by SHRUNK or more
ratio_median, ratio_p90 : of RMSE after over the noise floor
seconds_median, seconds_worst : by the clock; cpu_median : of processors
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from bench.hidden_effects.score_case import ScoredCase
from bench.hidden_effects.wilson import Share, share

SHRUNK = 0.9
IN_LIBRARY = ("single", "pair", "weak", "hard", "bare")
Figure = Share | float


def figures(cases: Sequence[ScoredCase]) -> dict[str, Figure]:
    """Every figure, shares of no case included; a number of no case is NaN."""
    # What lies outside the library has no right name: it is counted apart.
    hidden = [case for case in cases if case.kind in IN_LIBRARY]
    single, pair, bare, outside = (_of(cases, kind) for kind in ("single", "pair", "bare", "outside"))
    ratios = [case.errors.ratio for case in hidden if case.errors]
    seconds = [case.seconds for case in cases if math.isfinite(case.seconds)]
    return {
        "naming": share(case.first_right for case in single),
        "exact_single": share(case.exact for case in single),
        "exact_pair": share(case.exact for case in pair),
        "weak": share(case.first_right for case in _of(cases, "weak")),
        "hard": share(case.first_right for case in _of(cases, "hard")),
        "bare_found": share(found for case in bare for found in case.found),
        "bare_true": Share(sum(case.true_names for case in bare), sum(case.names for case in bare)),
        "found_shown": _share_found([case for case in hidden if case.kind != "bare"]),
        "bare_found_shown": _share_found(bare),
        "shown": share(shows for case in hidden for shows in case.shows),
        "false_alarms": share(case.verdict != "nothing_missing" for case in _of(cases, "null")),
        "unknown": share(case.verdict == "unknown" for case in outside),
        "dependence": share(case.dependence for case in outside if case.dependence is not None),
        "unknown_wrongly": share(case.verdict == "unknown" for case in cases if case.kind != "outside"),
        "told": _told_share(hidden),
        "told_rivals": share(told for case in hidden
                             for told, has in zip(case.told, case.has_rivals, strict=True) if has),
        "coverage": share(covered for case in hidden for covered in case.covered.values()),
        "shrink": share(shrunk >= SHRUNK for shrunk in shrinks(hidden)),
        "shrink_mean": _mean([max(0.0, shrunk) for shrunk in shrinks(hidden)]),
        "ratio_median": _quantile(ratios, 0.5),
        "ratio_p90": _quantile(ratios, 0.9),
        "seconds_median": _quantile(seconds, 0.5),
        "seconds_worst": _quantile(seconds, 1.0),
        "cpu_median": _quantile([case.cpu_s for case in cases if math.isfinite(case.cpu_s)], 0.5),
        "failed": share(case.failed for case in cases),
    }  # fmt: skip


def _told_share(cases: Iterable[ScoredCase]) -> Share:
    pairs = [pair for case in cases for pair in zip(case.told, case.shows, strict=True)]
    return share(told for told, shows in pairs if shows)


def _share_found(cases: Iterable[ScoredCase]) -> Share:
    pairs = [pair for case in cases for pair in zip(case.found, case.shows, strict=True)]
    return share(found for found, shows in pairs if shows)


def by_effect(cases: Iterable[ScoredCase]) -> dict[str, Share]:
    """Single hidden effects: first name true; outside the library: unknown said."""
    answers: dict[str, list[bool]] = {}
    for case in cases:
        if case.kind == "single":
            answers.setdefault(case.hidden[0], []).append(case.first_right)
        elif case.kind == "outside":
            answers.setdefault(case.outside, []).append(case.verdict == "unknown")
    return {name: share(answers[name]) for name in sorted(answers)}


def by_kind(cases: Sequence[ScoredCase]) -> dict[str, dict[str, Figure]]:
    """Return the figures of every kind that hides effects of the library."""
    kinds = [kind for kind in IN_LIBRARY if _of(cases, kind)]
    return {kind: _of_kind(_of(cases, kind)) for kind in kinds}


def shrinks(cases: Iterable[ScoredCase]) -> list[float]:
    """Return the closed shares of the cases that had a gap."""
    found = [case.errors.shrink for case in cases if case.errors]
    return [shrunk for shrunk in found if shrunk is not None]


def _of_kind(cases: Sequence[ScoredCase]) -> dict[str, Figure]:
    return {
        "first_right": share(case.first_right for case in cases),
        "exact": share(case.exact for case in cases),
        "told": _told_share(cases),
        "coverage": share(covered for case in cases for covered in case.covered.values()),
        "shrink": share(shrunk >= SHRUNK for shrunk in shrinks(cases)),
        "ratio_median": _quantile([case.errors.ratio for case in cases if case.errors], 0.5),
        "seconds_median": _quantile([case.seconds for case in cases if math.isfinite(case.seconds)], 0.5),
    }


def _of(cases: Sequence[ScoredCase], kind: str) -> list[ScoredCase]:
    return [case for case in cases if case.kind == kind]


def _quantile(values: Sequence[float], level: float) -> float:
    """By nearest rank, so that infinite values are no problem."""
    return sorted(values)[max(0, math.ceil(level * len(values)) - 1)] if values else math.nan


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else math.nan


def document(solvers: Mapping[str, Sequence[ScoredCase]], facts: Mapping[str, Any]) -> dict[str, Any]:
    """Everything as JSON has it; infinity and NaN are null."""
    return {
        **facts,
        "solvers": {
            name: {
                "cases": len(cases),
                "figures": _plain(figures(cases)),
                "by_kind": {kind: _plain(found) for kind, found in by_kind(cases).items()},
                "by_effect": _plain(by_effect(cases)),
                "each": [_finite(asdict(case)) for case in cases],
            }
            for name, cases in solvers.items()
        },
    }


def write_document(path: Path, content: Mapping[str, Any]) -> None:
    """Errors: OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _plain(found: Mapping[str, Figure]) -> dict[str, Any]:
    return {
        key: item.document() if isinstance(item, Share) else _finite(float(item))
        for key, item in found.items()
    }


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
