"""`greenhouse replay RUN.csv...`: recorded runs through the same tick, in shadow, and their skill."""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from edge.app.replay import REPLAYED, Skill, decisions_digest, fired_limits, replay, score
from edge.commands.arguments import add_absent_columns, number
from edge.config import loading as config
from edge.config.settings import BoxSettings, Settings
from edge.core.controller_names import MPC_TWIN
from edge.core.errors import DataError
from edge.core.hard_limits import REFERENCE_MAX_C, REFERENCE_MIN_C
from edge.core.messages import TickRecord
from edge.core.names import HEATER_MAX_W
from edge.formats.atomic_file import make_folder, write_atomically
from edge.formats.input_file import TABLE, read_text
from edge.formats.reader import DocumentError, parse_json
from edge.formats.run_file import read_run
from edge.formats.tick_json import tick_json
from edge.models.arx_file import DEFAULT_PATH, read_arx
from edge.models.pbm import read_twin

HORIZONS_S = (60.0, 300.0, 900.0, 1800.0, 3600.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN.csv", help="recorded run")
    parser.add_argument(
        "--model",
        type=Path,
        default=DEFAULT_PATH,
        help="ARX model file, whose step is the replay's; default: the packaged one",
    )
    # The others ask a language model or a policy, which would not answer twice alike.
    parser.add_argument(
        "--controller",
        choices=REPLAYED,
        default="MPC",
        metavar="NAME",
        help=f"controller that decides in shadow: {', '.join(REPLAYED)}; default: %(default)s",
    )
    parser.add_argument("--twin", type=Path, help="twin file that MPC-Twin and MPC-Twin-P plan with")
    parser.add_argument(
        "--reference",
        type=number(REFERENCE_MIN_C, REFERENCE_MAX_C),
        default=24.0,
        metavar="DEGC",
        help="temperature to hold [°C]; default: %(default)g",
    )
    _add_forecasts(parser)
    add_absent_columns(parser, "fan_on", "temp_ambient_c")
    parser.add_argument(
        "--fan-always-on",
        action="store_true",
        help="take the fan as always on in runs without the column fan_on",
    )


def _add_forecasts(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--horizons",
        type=_horizons,
        default=HORIZONS_S,
        metavar="S,S,...",
        help=f"how far ahead forecasts are scored [s]; default: {','.join(f'{s:g}' for s in HORIZONS_S)}",
    )
    parser.add_argument("--out", type=Path, help="folder to write the ticks to, one JSON line each")
    parser.add_argument(
        "--again",
        type=Path,
        help="folder of an earlier --out: searches that the time limit ended then end at the same point",
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the skill table and the digest of every run's decisions."""
    model = read_arx(arguments.model)
    twin = None if arguments.twin is None else read_twin(arguments.twin)
    if twin is None and arguments.controller in MPC_TWIN:
        raise DataError(f"--controller {arguments.controller} needs --twin, the file that it plans with")
    settings = settings_for(model.step_s, arguments.controller, arguments.reference, arguments.twin)
    without = [*arguments.without, *(["fan_on"] if arguments.fan_always_on else [])]
    skills = []
    for path in arguments.runs:
        limits = (
            [] if arguments.again is None else fired_limits(_read(arguments.again / f"{path.stem}.jsonl"))
        )
        run = read_run(path, without)
        records = replay(run, settings, model, arguments.fan_always_on, limits, twin)
        skills.append(score(records, model, arguments.horizons))
        print(f"{path.name}: {len(records)} ticks, decisions {decisions_digest(records)[:16]}")
        if arguments.out is not None:
            _write(arguments.out / f"{path.stem}.jsonl", records)
    print()
    print("\n".join(skill_table(skills)))
    return 0


def settings_for(step_s: float, controller: str, reference_c: float, twin: Path | None = None) -> Settings:
    """Return the default settings at another step, in shadow. Limits in degrees and seconds stay.

    twin : of the box that safety shall know; None: the paper's
    """
    settings = config.default()
    return replace(
        settings,
        control=replace(settings.control, step_s=step_s, controller=controller),
        reference=replace(settings.reference, reference_c=reference_c),
        box=BoxSettings(heater_w=HEATER_MAX_W) if twin is None else BoxSettings(str(twin)),
    )


def skill_table(skills: Sequence[Sequence[Skill]]) -> list[str]:
    """All runs together, a line per horizon."""
    lines = ["horizon_s  forecasts  mae_k  persistence_mae_k  ratio"]
    for of_horizon in zip(*skills, strict=True):
        model = np.concatenate([skill.model for skill in of_horizon])
        persistence = np.concatenate([skill.persistence for skill in of_horizon])
        if len(model) == 0:
            lines.append(f"{of_horizon[0].horizon_s:9g}  {0:9d}      -                  -      -")
            continue
        mae, of_persistence = model.mean(), persistence.mean()
        lines.append(
            f"{of_horizon[0].horizon_s:9g}  {len(model):9d}  {mae:5.3f}  {of_persistence:17.3f}"
            f"  {mae / of_persistence:5.2f}"
        )
    return lines


def _horizons(text: str) -> tuple[float, ...]:
    return tuple(map(number(0.0, 1e6, above=True), text.split(",")))


def _read(path: Path) -> list[dict[str, Any]]:
    try:
        return [parse_json(line) for line in read_text(path, TABLE).splitlines()]
    except (OSError, DocumentError) as error:
        raise DataError(f"{path}: no ticks of an earlier replay: {error}") from error


def _write(path: Path, records: Sequence[TickRecord]) -> None:
    make_folder(path.parent)
    write_atomically(path, "".join(json.dumps(tick_json(record)) + "\n" for record in records))
