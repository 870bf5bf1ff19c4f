"""python -m bench.boxes.thirty_hours: whether even thirty hours of a box's own are worth six of them.

Beside what `bench.boxes.fleet --out` has of a box that is new: the twin of its six hours of tests and the day
after, in the structure that the others of its kind have. The day judges it too, so that its error is one of
a fit. Its cost is not. The last column, a cost alone, is that of the box's own equations and true state in
place of a twin (clairvoyant.py), of which nothing that is learnt can know more. They are planned with along
their tangent, so a twin that was fitted over all of a large step may plan that one better. Where they are not
worth six hours either, chance has a say in what is counted.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from bench.boxes.__main__ import CLAIRVOYANT, OF_TWIN
from bench.boxes.fleet import (
    LITTLE_H,
    NEAR,
    FleetBox,
    NewBoxRow,
    boxes_of,
    chosen_fit,
    cost_of,
    day_error_k,
    first_hours,
    parser_of,
    place_of,
)
from bench.boxes.own_data import quiet
from bench.header import header
from edge.app.commission import learn
from edge.config.settings import ControlSettings
from edge.core.sweep import sweep
from edge.formats.reader import read_json
from edge.formats.run_file import read_run
from edge.twin.twin_file import read_twin_file

WAYS = ("6 h", "1 h and prior", "30 h", "own equations")


@dataclass(frozen=True, slots=True)
class LongRow:
    """Errors over the day that is known [K], NaN where none is, and costs, each by WAYS."""

    box: FleetBox
    error_k: tuple[float, ...]
    cost: tuple[float, ...]


def judge(out: Path, built: int, box: FleetBox) -> LongRow:
    """Return a box's row."""
    fleet = [FleetBox(box.design, number) for number in range(1, built + 1)]
    place = place_of(out, fleet)
    # What the daemon needs beside a twin is that of the hour.
    hour = first_hours(read_run(out / f"{box.name}.tests.csv"), LITTLE_H)
    found = learn(hour, read_twin_file(place / f"{box.name}.start.yaml"), ControlSettings(), quiet)
    own = replace(chosen_fit(out, fleet, box), sample_s=found.twin.sample_s)
    twin = replace(own, sensor={**own.sensor, "quantisation_k": found.twin.sensor["quantisation_k"]})
    costs = [cost_of(box, way, replace(found, twin=twin)) for way in (OF_TWIN, CLAIRVOYANT)]
    rows = [
        read_json(NewBoxRow, folder / f"{box.name}.{way.replace(' ', '-')}.json")
        for folder, way in ((out, WAYS[0]), (place, WAYS[1]))
    ]
    known = [[np.inf if row.error_k is None else row.error_k for row in rows]]
    known.append([np.inf if row.cost is None else row.cost for row in rows])
    return LongRow(box, (*known[0], day_error_k(out, box, twin), np.nan), (*known[1], *costs))


def lines(rows: Sequence[LongRow]) -> Iterator[str]:
    """Yield a line for each box, then how often each way is as good as six hours."""
    yield f"{'box':<8}" + "".join(f"{way:>22}" for way in WAYS)
    for row in rows:
        figures = zip(row.error_k, row.cost, strict=True)
        yield f"{row.box.name:<8}" + "".join(
            f"{'' if np.isnan(error_k) else f'{error_k:.2f}':>13}{cost:9.1f}" for error_k, cost in figures
        )
    for key in ("error_k", "cost"):
        every = np.array([getattr(row, key) for row in rows])
        for way, own in list(zip(WAYS, every.T, strict=True))[1:]:
            if np.isnan(own).all():
                continue
            worth, near = (int((own <= share * every[:, 0]).sum()) for share in (1.0, 1.0 + NEAR))
            counted = f"in {worth} of {len(rows)}, no more than {NEAR:.0%} worse in {near}"
            yield f"{key}: {way} is as good as 6 h {counted}"


def main(words: Sequence[str] | None = None) -> int:
    """Print a table of boxes, beside what `bench.boxes.fleet` measured of them."""
    given = parser_of("thirty_hours", __doc__).parse_args(words)
    print("\n".join(header()), flush=True)
    boxes = boxes_of(given)
    rows = sweep(partial(judge, given.out, given.built), boxes, given.workers, given.dask)
    print("\n".join(lines(rows)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
