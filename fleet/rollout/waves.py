"""The rigs that get a bundle in a wave. Pure; rigs are chosen at random within each kind."""

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil

SHARES = (0.01, 0.10, 1.0)  # of each kind that has the bundle after a wave
LEAST_OF_KIND = 6  # new rigs of a kind in a wave: of four, all may be of the few that a bad bundle suits


@dataclass(frozen=True, slots=True)
class KindRigs:
    """Rigs of one kind. total : that the bundle is for; waiting : that could get it now, by name"""

    total: int
    waiting: Sequence[str]


def is_last(wave: int) -> bool:
    """Return whether a wave is for all that is left. wave : from 1"""
    return wave >= len(SHARES)


def choose_wave(wave: int, kinds: Mapping[str, KindRigs], reached: Mapping[str, int], seed: str) -> list[str]:
    """Return the rigs of a wave.

    All but the last wave leave as many rigs of a kind waiting as they take, to be compared with. So a kind
    with a single rig has its turn in the last wave.

    wave : from 1; reached : rigs of each kind that had the bundle ordered before
    seed : the same one gives the same choice
    """
    chosen: list[str] = []
    for kind, rigs in sorted(kinds.items()):
        count = wave_size(wave, rigs.total, reached.get(kind, 0), len(rigs.waiting))
        chosen += random.Random(f"{seed} {wave} {kind}").sample(sorted(rigs.waiting), count)
    return chosen


def wave_size(wave: int, total: int, reached: int, waiting: int) -> int:
    """Return how many rigs of a kind a wave takes."""
    if is_last(wave):
        return waiting
    wanted = max(ceil(SHARES[wave - 1] * total) - reached, LEAST_OF_KIND)
    return min(wanted, waiting // 2)
