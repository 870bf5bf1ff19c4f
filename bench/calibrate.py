"""python -m bench.calibrate ANSWERS...: how sure a name is, from what rows that no fit saw say of it.

ANSWERS are folders of development answers: of `bench.foreign` (DIR/dev with cases, truth, answers), of
`bench.hidden_effects run` (given as ANSWERS:TRUTHS) or of `bench.real_truth --out DIR` (which count MEASURED
times, as there are few). A logistic regression of whether a name was right, on two numbers of its evidence,
each of which can only help, prints the coefficients of
edge/diagnosis/verdict.py and what was said beside what held. Names are right by class, as
`bench.foreign.score` has it. Scored cases have no part in it.
"""

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.foreign.score import bins, calibration_error, match_names
from bench.hidden_effects.wilson import share
from bench.real_truth.__main__ import folder_name, is_true
from bench.real_truth.logs import LOGS
from edge.diagnosis.verdict import MOST_SURE, evidence

MEASURED = 3
RIDGE = 0.05  # of the slopes, so that a perfect separation stays finite


def main(words: Sequence[str] | None = None) -> int:
    """Fit, and print."""
    places = list(sys.argv[1:] if words is None else words)
    if not places:
        print(__doc__, end="")
        return 2
    told = [pair for place in places for pair in statements(place)]
    numbers, right = np.array([own for own, _ in told]), np.array([own for _, own in told], dtype=bool)
    weights = fit_curve(numbers, right)
    print(f"{len(told)} names, {int(right.sum())} of them right")
    print("intercept, nats, ratio:", ", ".join(f"{weight:.2f}" for weight in weights))
    odds = weights[0] + numbers @ weights[1:]
    said = np.minimum(MOST_SURE, 1.0 / (1.0 + np.exp(-odds)))
    pairs = list(zip(said.tolist(), right.tolist(), strict=True))
    for (low, high), own in bins(pairs).items():
        held = share(true for _, true in own)
        print(f"{low:.2f} to {min(high, 1.0):.2f}: held {held.value:.2f} of {held.cases}")
    print(f"calibration error {calibration_error(pairs):.3f}")
    return 0


def statements(place: str) -> Iterator[tuple[tuple[float, float], bool]]:
    """Evidence of each name, and whether it is right; of development answers."""
    is_measured = not _has_truths(place)
    for _ in range(MEASURED if is_measured else 1):
        for document, right in documents(place, "dev"):
            for item, is_right in zip(document["effects"], right, strict=True):
                yield _evidence(item), is_right


def documents(place: str, split: str = "") -> Iterator[tuple[dict[str, Any], list[bool]]]:
    """Answers, and which of their names are right. split : of measured logs, "" for both"""
    if not _has_truths(place):
        yield from _measured_answers(Path(place), split)
        return
    answers, _, truths = place.partition(":")
    folder = Path(answers) if truths else Path(answers) / "answers"
    truth_folder = Path(truths) if truths else Path(answers) / "truth"
    for path in sorted(folder.glob("*/diagnosis.json")):
        document = json.loads(path.read_text(encoding="utf-8"))
        truth = json.loads((truth_folder / f"{path.parent.name}.json").read_text(encoding="utf-8"))
        yield document, list(match_names([item["name"] for item in document["effects"]], hidden_of(truth)))


def _has_truths(place: str) -> bool:
    return ":" in place or (Path(place) / "truth").is_dir()


def _measured_answers(folder: Path, split: str) -> Iterator[tuple[dict[str, Any], list[bool]]]:
    """Yield the answers about logs with known contents."""
    for log in LOGS:
        path = folder / "answers" / folder_name(log) / "diagnosis.json"
        if path.exists() and split in ("", log.split):
            document = json.loads(path.read_text(encoding="utf-8"))
            yield document, [is_true(log, item["name"]) for item in document["effects"]]


def _evidence(item: dict[str, Any]) -> tuple[float, float]:
    own = item["left_out"]
    return evidence(own["tempered_nats"], own["with_k"], own["without_k"])


def hidden_of(truth: dict[str, Any]) -> list[str]:
    """Names, as either kind of truth has them."""
    return [item if isinstance(item, str) else item["name"] for item in truth["hidden"]]


def fit_curve(numbers: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Intercept and two slopes, of which none has the wrong sign."""
    from scipy.optimize import minimize

    sign = np.where(right, 1.0, -1.0)

    def loss(weights: np.ndarray) -> float:
        odds = weights[0] + numbers @ weights[1:]
        return float(np.logaddexp(0.0, -sign * odds).sum() + RIDGE * (weights[1:] ** 2).sum())

    bounds = [(None, None), (0.0, None), (0.0, None)]
    return np.asarray(minimize(loss, np.array([0.0, 1.0, 1.0]), bounds=bounds).x)


if __name__ == "__main__":
    raise SystemExit(main())
