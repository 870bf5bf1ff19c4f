"""python -m bench attack: every part of the attack, its seeds and its violations; 1 when there is one."""

import argparse
import sys
from collections.abc import Sequence

from bench import kills
from bench.attack import answers, bundles, files, floods, links, payloads, scenarios
from bench.attack.part import Part, report

PARTS: dict[str, tuple[Part, int]] = {  # and how many cases
    "scenarios": (scenarios.run, 1000),
    "floods": (floods.run, 4 * len(floods.FLOODS)),
    "answers": (answers.run, 100),
    "payloads": (payloads.run, 2000),
    "files": (files.run, 200),
    "bundles": (bundles.run, 200),
    "links": (links.run, 400),
    "kills": (kills.attack, 1000),
}


def main(words: Sequence[str] | None = None) -> int:
    """Run the parts that are named, or all."""
    parser = argparse.ArgumentParser(prog="python -m bench.attack", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; none: all")
    parser.add_argument("--seed", type=int, default=1, help="of the first case of each part")
    parser.add_argument("--share", type=float, default=1.0, help="of the cases, for a short run")
    arguments = parser.parse_args(words)
    if unknown := [name for name in arguments.parts if name not in PARTS]:
        parser.error(f"there is no {unknown[0]!r}; there are {', '.join(PARTS)}")
    bad = 0
    for name in arguments.parts or PARTS:
        part, count = PARTS[name]
        bad += report(part, arguments.seed, max(1, round(count * arguments.share)), name)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
