"""Nuisances: small errors of every twin of this kind that need no name."""

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.trial import SizedTerm
from edge.twin.model import BoxTwin
from edge.twin.network import AIR
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import TwinFile
from edge.twin.warm_start import hold

Floats = NDArray[np.float64]
CURVATURE_SD = 0.04  # of a loss over 10 K: films thin and seals give as a box warms
EXCESS_K = 10.0
USUAL_LOSS_W_K = 8.0  # of a box as large as the paper's whose twin is not said to lose heat, and lacks that
ROOM_SD_K = 2.0  # of a room about a run's first temperature: a run begins at rest or soon after another
FALLS_K, FALLS_SHARE = 2.0, 0.1  # below its first temperature a run that began at rest goes by no more
WARMEST_ROOM_C = 35.0
ROOM_C, ANY_ROOM_SD_K = 20.0, 10.0  # of a run that begins hot: its room may be any that people work in


def nuisances(file: TwinFile, runs: RunBatch, temps: Floats) -> tuple[SizedTerm, ...]:
    """Terms for every trial on these runs. temps : [B, N + 1], the air without its reading's noise [°C]"""
    loss_w_k = still_loss_w_k(file.twin()) or USUAL_LOSS_W_K * file.scale.heat
    return (curved_loss(runs, temps, CURVATURE_SD * loss_w_k),)


def curved_loss(runs: RunBatch, temps: Floats, sd_w_k: float) -> SizedTerm:
    """Return a loss that grows with T - T_amb: Q = -k (|T - T_amb| - E) (T - T_amb) / 10 K.

    E is where these runs tell a straight loss best, so that k takes nothing of what that one is.
    """
    excess = (middle(temps) - runs.ambient).T
    squares = np.nansum(excess**2)
    usual_k = np.nansum(np.abs(excess) ** 3) / squares if squares > 0.0 else 0.0
    return SizedTerm("curved loss", -(np.abs(excess) - usual_k) * excess / EXCESS_K, sd_w_k)


def middle(temps: Floats) -> Floats:
    """In the middle of each row [B, N], of [B, N + 1]; what was not measured is as it was last."""
    known = np.stack([hold(row) for row in temps])
    return np.asarray(0.5 * (known[:, 1:] + known[:, :-1]))


def still_loss_w_k(twin: BoxTwin) -> float:
    """Heat that keeps the air 1 K above the room with the fan off [W/K]; 0 for a box that loses none."""
    system = twin.system
    try:
        warmed = -np.linalg.solve(system.rates, system.drive[:, 2])[system.states.index(AIR)]
    except np.linalg.LinAlgError:
        return 0.0
    return float(system.air_capacity_j_k / warmed) if warmed > 1e-9 else 0.0


def answer_s(twin: BoxTwin) -> float | None:
    """Time constant of the air and what is in close contact with it, the fan off; None of no loss."""
    loss_w_k = still_loss_w_k(twin)
    return twin.system.air_capacity_j_k / loss_w_k if loss_w_k else None


def begins_at_rest(temps: Floats) -> bool:
    """Return whether a run's first temperature may be the ambient's. temps : [N], NaN where not measured"""
    known = temps[np.isfinite(temps)]
    falls_k = max(FALLS_K, FALLS_SHARE * float(np.ptp(known)))
    return bool(known[0] <= WARMEST_ROOM_C and known[0] - known.min() <= falls_k)


def assumed_room(temps: Floats) -> float:
    """Return the ambient assumed for a run that recorded none. temps : [N], NaN where not measured"""
    known = temps[np.isfinite(temps)]
    return float(known[0]) if begins_at_rest(temps) else min(ROOM_C, float(known.min()))


def rooms(runs: RunBatch) -> tuple[SizedTerm, ...]:
    """Return an ambient offset per run that recorded none: the distance from the assumed one."""
    count, rows = runs.duty.shape
    sds = [ROOM_SD_K if begins_at_rest(temps) else ANY_ROOM_SD_K for temps in runs.temp]
    return tuple(
        SizedTerm(f"room of run {i + 1}", np.repeat(np.eye(count)[i : i + 1], rows, axis=0), sd, of_room=True)
        for i, sd in enumerate(sds)
    )
