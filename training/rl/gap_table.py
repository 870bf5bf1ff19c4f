"""The table of `greenhouse-train rl-gap`: every kept policy with and without randomisation, seed by seed."""

import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path

from edge.models.onnx_policy import read_policy
from training.rl.gap import LEAD_STEPS, RIG_SEEDS, STEPS, PolicyGap, gap_of
from training.rl.models import StepModel
from training.rl.saved_policy import POLICY_FILE, Record, read_record

_COLUMNS = ("model", "rig", "gap", "model", "rig", "gap")
_HEAD = f"{'policy':9s} {'parameters':11s} {'seed':>12s}" + "".join(f"{name:>15s}" for name in _COLUMNS)


def gap_table(groups: Sequence[tuple[str, Sequence[Path]]], model: StepModel, command: str) -> Iterator[str]:
    """Lines, one as soon as it is known; groups : (how the parameters were, folders of policies)."""
    yield f"# {command}"
    yield f"# Model {model.name} {model.sha256[:12]}; boards {', '.join(map(str, RIG_SEEDS))}; {STEPS} steps"
    yield f"# of a minute after {LEAD_STEPS} of lead-in, references drawn at random by the board's seed."
    yield "# MAE [K]: of the true air in the model, of the measured air on the rig; then reward of a step,"
    yield "# and the gap: rig less model. parameters: of the training model, drawn: uniformly within their"
    yield "# 95 % intervals, anew for each episode. The last lines of a group: mean ± sd over its seeds."
    yield f"{'':34s}{'MAE [K]':>30s}{'reward of a step':>45s}"
    yield _HEAD
    for parameters, folders in groups:
        found: list[PolicyGap] = []
        for folder in folders:
            record = read_record(folder)
            gap = gap_of(read_policy(folder / POLICY_FILE, record["variant"]), model)
            found.append(gap)
            yield _name(record, parameters, str(record["seed"])) + _cells([gap])
        if found:
            yield _name(record, parameters, f"all {len(found)}") + _cells(found)


def hashes(groups: Sequence[tuple[str, Sequence[Path]]]) -> Iterator[str]:
    """Lines: which policies the table is about."""
    for _, folders in groups:
        for folder in folders:
            record = read_record(folder)
            yield f"# {record['variant']} seed {record['seed']} {record['policy']}: {record['command']}"


def _name(record: Record, parameters: str, seed: str) -> str:
    return f"{record['variant']:9s} {parameters:11s} {seed:>12s}"


def _cells(gaps: Sequence[PolicyGap]) -> str:
    columns = (
        [gap.model_mae_k for gap in gaps],
        [gap.rig_mae_k for gap in gaps],
        [gap.rig_mae_k - gap.model_mae_k for gap in gaps],
        [gap.model_reward for gap in gaps],
        [gap.rig_reward for gap in gaps],
        [gap.rig_reward - gap.model_reward for gap in gaps],
    )
    return "".join(f"{_spread(column):>15s}" for column in columns)


def _spread(values: Sequence[float]) -> str:
    if len(values) == 1:
        return f"{values[0]:.3f}"
    return f"{statistics.fmean(values):.3f} ± {statistics.stdev(values):.3f}"
