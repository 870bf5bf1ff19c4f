"""`greenhouse fit-arx`: an ARX model from recorded runs, its orders chosen on others."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from edge.commands.arguments import number, writing
from edge.core.hard_limits import STEP_MAX_S
from edge.formats.run_file import RecordedRun, read_run
from edge.models.arx import FanInput
from edge.models.arx_file import write_arx
from edge.models.fit_arx import ArxFit, fit_arx, provenance


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--train", type=Path, nargs="+", required=True, metavar="RUN", help="runs to fit on")
    parser.add_argument(
        "--validate", type=Path, nargs="+", required=True, metavar="RUN", help="runs to choose the orders on"
    )
    parser.add_argument("--out", type=Path, required=True, help="model file, for control.model")
    parser.add_argument(
        "--step-s",
        type=number(0.0, STEP_MAX_S, above=True),
        default=60.0,
        help="control step of the model [s]; default: %(default)g",
    )
    parser.add_argument(
        "--fan",
        choices=("excess", "on", "none"),
        help="how the fan enters; default: by the excess of the air over the room (if there is a "
        "room temperature), as on or off (the paper's), or not at all, e.g. where it never switched",
    )
    parser.add_argument(
        "--no-fan", action="store_const", const="none", dest="fan", help="the same as --fan none"
    )
    parser.add_argument("--no-ambient", action="store_true", help="leave the room temperature out")


def run(arguments: argparse.Namespace) -> int:
    """0, and the scores of all orders on standard output."""
    without = ["fan_on"] * (arguments.fan == "none") + ["temp_ambient_c"] * arguments.no_ambient
    training = [read_run(path, without) for path in arguments.train]
    validation = [read_run(path, without) for path in arguments.validate]
    fan: FanInput | Literal["none"] = arguments.fan or ("on" if arguments.no_ambient else "excess")
    fit = fit_arx(
        training,
        validation,
        arguments.step_s,
        fan_input=None if fan == "none" else fan,
        with_ambient=not arguments.no_ambient,
    )
    facts = _provenance(fit, training, validation, arguments)
    with writing(arguments.out):
        write_arx(fit.model, arguments.out, facts)
    print_scores(fit)
    print(f"{arguments.out}: p = {len(fit.model.temp)}, q = {len(fit.model.heater)}, {fit.rows} rows")
    return 0


def print_scores(fit: ArxFit) -> None:
    """Free-run error of every pair of orders; the chosen one is marked."""
    chosen = (len(fit.model.temp), len(fit.model.heater))
    print(" p  q  free-run RMSE [K]")
    for score in fit.scores:
        mark = "  chosen" if (score.p, score.q) == chosen else ""
        print(f"{score.p:2d} {score.q:2d}  {score.rmse_k:.3f}{mark}")


def _provenance(
    fit: ArxFit,
    training: Sequence[RecordedRun],
    validation: Sequence[RecordedRun],
    arguments: argparse.Namespace,
) -> dict[str, object]:
    """As `fit_arx.provenance`, by file names: where the files lay says nothing to others."""
    options = f" --fan {arguments.fan}" * bool(arguments.fan) + " --no-ambient" * arguments.no_ambient
    command = f"greenhouse fit-arx --step-s {arguments.step_s:g}{options}"
    facts = provenance(fit, training, validation, command)
    for key in ("training_sha256", "validation_sha256"):
        facts[key] = {Path(path).name: digest for path, digest in facts[key].items()}
    return facts
