"""Innovations of many twins over the same runs: what each row tells beyond all rows before it.

A Kalman filter over each twin's states, a coloured heat into the air that the twin does not know (first
order, constant over a row) and one factor on the heater's power per run. Given linear steps and Gaussian
noise the sum of squared innovations is the likelihood, hidden starts and all (Jazwinski 1970, ch. 7;
Kristensen, Madsen & Jørgensen 2004, Automatica 40). It works on errors: a column is the measured minus a free
run, or the effect of something on a free run, and comes out whitened.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.twin.linearise import LinearSteps

Floats = NDArray[np.float64]
BLOCK = 128  # rows whose matrices are made at a time


@dataclass(frozen=True, slots=True)
class NoiseLevels:
    """Noise of a twin's states and readings, standard deviations.

    sensor_k : of a reading, its rounding included; room_k : of the room's reading
    heat_w, heat_tau_s : unknown heat into the air, and how long it goes together
    power_share : of the heater's power from run to run
    """

    sensor_k: float
    room_k: float
    heat_w: float
    heat_tau_s: float
    power_share: float


class FilterInput(NamedTuple):
    """A twin to be filtered: steps, noise, spread of its start [n] or [B, n], and the length of a row [s]."""

    steps: LinearSteps
    levels: NoiseLevels
    spread: Floats
    step_s: float


@dataclass(frozen=True, slots=True, eq=False)
class FilterGains:
    """Gains of C filters over N rows of B runs, m states each, padded.

    rows : [N, C, B, m + 1, m + 1], what a row makes of the states and its reading, behind each other: the
        states after it, and what the reading was expected to be; the last column is 0 where nothing was read
    sd : [N, C, B], of the innovation [K]
    measured : [B, N], where something was read
    """

    rows: Floats
    sd: Floats
    measured: NDArray[np.bool_]


def gains(twins: Sequence[FilterInput], measured: NDArray[np.bool_]) -> FilterGains:
    """Run the covariances. measured : [B, N], after each row."""
    walk = _Walk(twins, measured)
    found = np.zeros((measured.shape[1], *walk.shape, walk.states + 1, walk.states + 1))
    sds = np.empty(found.shape[:3])
    for rows in walk.blocks():
        step = found[rows]
        flipped = walk.forward(rows, step)
        for k, row in enumerate(step):
            gain, variance = walk.row(rows.start + k, row[..., :-1, :-1], flipped[k])
            sds[rows.start + k] = np.sqrt(variance)
            row[..., :-1, -1] = gain
        step[..., -1, :-1] = step[..., 0, :-1]
        step[..., :-1, :-1] -= step[..., :-1, -1:] * step[..., -1:, :-1]
    return FilterGains(found, sds, measured)


def log_likelihoods(twins: Sequence[FilterInput], measured: NDArray[np.bool_], errors: Floats) -> Floats:
    """Return the log likelihood of free-run errors by each filter, up to a constant of the data, [C].

    measured : [B, N]; errors : [C, B, N] [K], finite
    """
    walk = _Walk(twins, measured)
    total = np.zeros(walk.shape)
    in_time = np.ascontiguousarray(errors.transpose(2, 0, 1))
    for rows in walk.blocks():
        step = np.zeros((rows.stop - rows.start, *walk.shape, walk.states, walk.states))
        flipped = walk.forward(rows, step)
        for k, error in enumerate(in_time[rows]):
            gain, variance = walk.row(rows.start + k, step[k], flipped[k])
            off = error - walk.mean[..., 0]
            walk.mean += gain * off[..., None]
            total += np.where(measured[:, rows.start + k], off**2 / variance + np.log(variance), 0.0)
    return np.asarray(-0.5 * total.sum(axis=1))


class _Walk:
    """Covariances of C filters on their way over N rows of B runs, and what the errors so far say.

    shape : C, B; states : m, those that every filter has room for; mean : [C, B, m], of the states
    """

    def __init__(self, twins: Sequence[FilterInput], measured: NDArray[np.bool_]) -> None:
        self._twins, self._measured = twins, measured
        self._heat = max(len(item.steps.states) for item in twins)
        self.shape, self.states = (len(twins), len(measured)), self._heat + 2
        known = (*self.shape, self.states, self.states + 1)
        self._known, self._half = np.zeros(known), np.empty(known)  # covariance, and mean behind it
        for known_of, item in zip(self._known, twins, strict=True):
            np.einsum("bii->bi", known_of[..., :-1])[...] = _start(item, self._heat) ** 2
        self.mean, self._covariance = self._known[..., -1], np.empty((*self.shape, self.states, self.states))
        self._sensor = np.array([[item.levels.sensor_k**2] for item in twins])
        self._fresh = np.array([[item.levels.heat_w**2 * (1.0 - _kept_share(item) ** 2)] for item in twins])

    def blocks(self) -> Iterator[slice]:
        """All rows, so many at a time."""
        count = self._measured.shape[1]
        for begin in range(0, count, BLOCK):
            yield slice(begin, min(begin + BLOCK, count))

    def forward(self, rows: slice, step: Floats) -> Floats:
        """Fill in what rows make of the states, A; A' and below it the room's error r', [K, C, B, m + 1, m].

        step : [K, C, B, m, m] or wider, zeros. A row's covariance is A P A' + r r'.
        """
        size = self._heat
        flipped = np.zeros((len(step), *self.shape, self.states + 1, self.states))
        for i, item in enumerate(self._twins):
            own, steps = len(item.steps.states), item.steps
            step[:, i, :, :own, :own] = steps.table[steps.index[rows]]
            step[:, i, :, :own, size], step[:, i, :, :own, size + 1] = steps.heat[rows], steps.duty[rows]
            step[:, i, :, size, size], step[:, i, :, size + 1, size + 1] = _kept_share(item), 1.0
            flipped[:, i, :, -1, :own] = steps.room[rows] * item.levels.room_k
        flipped[..., :-1, :] = step[..., : self.states, : self.states].swapaxes(-1, -2)
        return flipped

    def row(self, k: int, step: Floats, flipped: Floats) -> tuple[Floats, Floats]:
        """Go on by row k: the reading's gain [C, B, m], 0 where there is none, and its variance [C, B]."""
        # `edge.twin.filter` in a form of its own: mean and room share the covariance's product, without new
        # arrays. A search walks thousands of rows with tens of twins, where new arrays cost as much as sums.
        np.matmul(step, self._known, out=self._half)
        self.mean[...] = self._half[..., -1]
        self._half[..., -1] = flipped[..., -1, :]
        covariance = np.matmul(self._half, flipped, out=self._covariance)
        covariance[..., self._heat, self._heat] += self._fresh
        variance = covariance[..., 0, 0] + self._sensor
        first = covariance[..., 0, :]
        gain = first * (self._measured[:, k] / variance)[..., None]
        np.subtract(covariance, gain[..., :, None] * first[..., None, :], out=self._known[..., :-1])
        return gain, variance


def _start(item: FilterInput, size: int) -> Floats:
    """Return the standard deviations of the states before the first row,
    the unknown heat's and the power's last.

    Returns : [m], or [B, m]
    """
    found = np.zeros((*item.spread.shape[:-1], size + 2))
    found[..., : item.spread.shape[-1]] = item.spread
    found[..., size:] = item.levels.heat_w, item.levels.power_share
    return found


def _kept_share(item: FilterInput) -> float:
    """Share of the unknown heat that is still there after a row."""
    return float(np.exp(-item.step_s / item.levels.heat_tau_s))


def whiten(
    filters: FilterGains, owner: NDArray[np.intp], columns: Floats, everywhere: bool = False
) -> Floats:
    """Columns in standard deviations of their innovation, 0 where nothing was measured.

    owner : [M], the filter of each column; columns : [M, B, N] [K], finite
    everywhere : also where nothing was measured, from what was before
    Returns : [M, B, N]
    """
    place = _places(owner, filters.sd.shape[1])
    known = np.zeros((*filters.rows.shape[1:4], int(place.max()) + 1))  # the states, and the reading last
    found = np.empty((columns.shape[2], *columns.shape[:2]))
    in_time = np.ascontiguousarray(columns.transpose(2, 0, 1))
    for k, row in enumerate(filters.rows):
        known[owner, :, -1, place] = in_time[k]
        known = row @ known
        found[k] = known[owner, :, -1, place]
    np.subtract(in_time, found, out=found)
    found /= filters.sd[:, owner]
    shown = found.transpose(1, 2, 0)
    return shown if everywhere else np.where(filters.measured, shown, 0.0)


def _places(owner: NDArray[np.intp], filters: int) -> NDArray[np.intp]:
    """Return the place of each column among those of its filter."""
    before = np.zeros(filters, dtype=np.intp)
    found = np.empty_like(owner)
    for i, own in enumerate(owner):
        found[i] = before[own]
        before[own] += 1
    return found
