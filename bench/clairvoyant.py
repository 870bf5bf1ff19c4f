"""python -m bench.clairvoyant: is the limit a limit? Twice the beam, of kinds half as wide, beside the usual.

Every regret of the comparison is against the plan of the usual beam; what a wider one finds beyond it is
what that plan leaves.
"""

import argparse
from dataclasses import replace

from edge.formats.table import Table
from training.control.clairvoyant import KIND_K, WIDTH, best_plan
from training.control.draw_references import FOLDER
from training.control.job import ComparisonJob, course_of, fresh_chamber
from training.control.rig import entries

LIMITS = [
    name for name, entry in entries().items() if entry.clairvoyant is not None and entry.rule != "present"
]
HEADS = ("reference", "limit", "seed", "cost", "twice the beam", "changes it by")
ALL_MIN = 24 * 60


def main() -> None:
    """Print the table."""
    known = sorted(path.stem for path in FOLDER.glob("*.csv"))
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--limits", nargs="+", choices=LIMITS, default=LIMITS, metavar="NAME")
    parser.add_argument("--references", nargs="+", choices=known, default=["reference_1", "reference_2"])
    parser.add_argument("--seed", type=int, default=1, help="of the virtual board")
    parser.add_argument("--minutes", type=int, default=ALL_MIN, help="of the reference, from its start")
    told = parser.parse_args()
    rows = [
        _row(ComparisonJob(entries()[limit], reference, told.seed), told.minutes)
        for reference in told.references
        for limit in told.limits
    ]
    print(
        "\n".join(Table("The clairvoyant optimum", HEADS, tuple(rows), "Costs as in the comparison.").text())
    )


def _row(job: ComparisonJob, minutes: int) -> tuple[str, ...]:
    course = course_of(job)
    assert course is not None
    course = replace(course, reference=course.reference[:minutes])
    usual = best_plan(lambda: fresh_chamber(job), course).cost
    twice = best_plan(lambda: fresh_chamber(job), course, 2 * WIDTH, KIND_K / 2.0).cost
    change = f"{100.0 * (twice / usual - 1.0):+.2f} %"
    return job.reference, job.entry.name, str(job.seed), f"{usual:.1f}", f"{twice:.1f}", change


if __name__ == "__main__":
    main()
