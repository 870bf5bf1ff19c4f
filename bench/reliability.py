"""python -m bench.reliability PLACE... --out PICTURE: how often names held that were said with a probability.

PLACE is a folder of answers with a name before it: of `bench.foreign` (`foreign=DIR/scored`, with truth and
answers) or of `bench.real_truth --out DIR` (`measured=DIR`). Each name that stood counts once. Printed and
drawn: by bins, what was said in the mean, what held with its 95 % interval, and of how many.
"""

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.foreign.score import bins, calibration_error, match_names
from bench.header import share
from bench.real_truth.__main__ import folder_name, is_true
from bench.real_truth.logs import LOGS

Statements = list[tuple[float, bool]]
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")


def main(words: Sequence[str] | None = None) -> int:
    """Print and draw."""
    parser = argparse.ArgumentParser(prog="python -m bench.reliability", description=__doc__)
    parser.add_argument("places", nargs="+", metavar="NAME=PLACE")
    parser.add_argument("--out", type=Path, required=True, help="picture to write")
    arguments = parser.parse_args(words)
    told: dict[str, Statements] = {}
    for place in arguments.places:
        name, _, where = place.partition("=")
        told.setdefault(name, []).extend(_statements(where))
    told = {name: own for name, own in told.items() if own}
    for name, own in told.items():
        print(*_lines(name, own), sep="\n")
    print(*_lines("all", [item for own in told.values() for item in own]), sep="\n")
    _draw(told, arguments.out)
    return 0


def _statements(place: str) -> Iterator[tuple[float, bool]]:
    folder = Path(place)
    answers = _answers if (folder / "truth").is_dir() else _measured_answers
    for document, right in answers(folder):
        for item, is_right in zip(document["effects"], right, strict=True):
            yield item["probability"], is_right


def _answers(folder: Path) -> Iterator[tuple[dict[str, Any], list[bool]]]:
    """Yield the answers about simulated cases, and which of their names are right, by class."""
    for path in sorted(folder.glob("answers/*/diagnosis.json")):
        document, truth = (
            json.loads(file.read_text(encoding="utf-8"))
            for file in (path, folder / "truth" / f"{path.parent.name}.json")
        )
        names = [item["name"] for item in document["effects"]]
        yield document, list(match_names(names, list(truth["hidden"])))


def _measured_answers(folder: Path) -> Iterator[tuple[dict[str, Any], list[bool]]]:
    """Yield the answers about logs with known contents."""
    for log in LOGS:
        path = folder / "answers" / folder_name(log) / "diagnosis.json"
        if log.main and path.exists():
            document = json.loads(path.read_text(encoding="utf-8"))
            yield document, [is_true(log, item["name"]) for item in document["effects"]]


def _lines(name: str, told: Statements) -> Iterator[str]:
    yield f"{name}: {len(told)} names, calibration error {calibration_error(told):.3f}"
    for (low, high), own in bins(told).items():
        found = share(right for _, right in own)
        said = sum(probability for probability, _ in own) / len(own)
        yield (
            f"  {low:.2f} to {min(high, 1.0):.2f}: said {said:.2f}, held {found.value:.2f} "
            f"[{found.interval[0]:.2f}, {found.interval[1]:.2f}] of {found.cases}"
        )


def _draw(told: Mapping[str, Statements], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(5.2, 4.8), layout="constrained")
    axes.plot([0.0, 1.0], [0.0, 1.0], color="0.6", lw=1.0, label="as said")
    for number, ((name, own), colour) in enumerate(zip(told.items(), COLOURS, strict=False)):
        for i, part in enumerate(bins(own).values()):
            # A little beside each other, or the error bars of the sets would hide one another.
            found = share(right for _, right in part)
            said = sum(probability for probability, _ in part) / len(part) + 0.012 * (number - 1)
            low, high = found.interval
            ends = [[max(found.value - low, 0.0)], [max(high - found.value, 0.0)]]
            label = f"{name} ({len(own)} names)" if i == 0 else None
            axes.errorbar(
                said, found.value, ends, fmt="o", color=colour, ms=5, capsize=2, lw=1.0, label=label
            )
            axes.annotate(
                str(found.cases), (said, found.value), (4, -11), textcoords="offset points",
                fontsize=8, color=colour,
            )  # fmt: skip
    axes.set(xlabel="probability that was said", ylabel="share of names that were right")
    axes.set_xlim(0.35, 1.03)
    axes.set_ylim(0.0, 1.05)
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    pyplot.close(figure)


if __name__ == "__main__":
    raise SystemExit(main())
