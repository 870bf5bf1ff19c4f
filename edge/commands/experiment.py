"""`greenhouse experiment PROFILE --out RUN`: apply a profile through the same loop and record a run."""

import argparse
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from edge.app.experiment import ROLES, Experiment, describe_changes, run_experiment
from edge.board.sim_clock import SimClock
from edge.board.virtual_rig import settings_in, virtual_rig
from edge.commands.arguments import SEED_MAX, number, whole, writing
from edge.commands.which_rig import RIG_CONFIG
from edge.config import loading as config
from edge.config.settings import Settings
from edge.controllers.input_profile import InputProfile
from edge.core.clock import Clock, RealClock
from edge.core.controller_names import CONTROLLERS
from edge.core.errors import DataError
from edge.formats.profile_file import Profile, read_profile
from edge.formats.reader import read_yaml
from edge.formats.run_file import RecordedRun, absence_facts, write_run

HISTORY_FACTS = ("history_id", "first_seq", "last_seq")  # mean nothing where no history is kept


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "profile",
        type=Path,
        help="CSV: time_s,heater_duty,fan_on[,light] or time_s,reference_c; a line `# record_from_s: 1800` "
        "above its header makes what comes before a lead-in: applied, but no part of the run",
    )
    parser.add_argument("--out", type=Path, required=True, help="run file to write")
    # No default: with a virtual board nobody means the rig's own file.
    parser.add_argument(
        "--config",
        type=Path,
        help=f"configuration file; default: {RIG_CONFIG}, with --virtual every setting's default",
    )
    parser.add_argument("--role", choices=ROLES, help="what the run is for; written into the run file")
    parser.add_argument("--notes", help="a note to write into the run file")
    parser.add_argument(
        "--controller",
        choices=CONTROLLERS,
        metavar="NAME",
        help="controller that follows a profile of references, as in `greenhouse demo --help`; default: MPC",
    )
    parser.add_argument(
        "--minutes",
        type=number(0.0, above=True),
        help="end after so many minutes; default: at the profile's end",
    )
    _add_virtual(parser)


def _add_virtual(parser: argparse.ArgumentParser) -> None:
    virtual = parser.add_argument_group("with a virtual board, as fast as it goes")
    virtual.add_argument("--virtual", action="store_true", help="use a virtual board instead of the rig's")
    virtual.add_argument(
        "--seed", type=whole(0, SEED_MAX), default=1, help="number that fixes the simulated noise; default: 1"
    )
    virtual.add_argument("--chamber", type=Path, help="YAML file that changes the simulated greenhouse")
    virtual.add_argument("--history", type=Path, help="database to store the ticks in; default: none")


def run(arguments: argparse.Namespace) -> int:
    """0 when the profile was applied to its end, 1 when stopped early; the run is written in both cases."""
    profile = read_profile(arguments.profile)
    _check_out(arguments.out)
    with rig_of(arguments) as (settings, clock):
        facts = {"role": arguments.role, "notes": arguments.notes, **_virtual_facts(arguments)}
        experiment = Experiment(
            profile,
            _controller(arguments, profile),
            float("inf") if arguments.minutes is None else 60.0 * arguments.minutes,
            {key: value for key, value in facts.items() if value is not None},
        )
        recorded, course = run_experiment(experiment, settings, clock)
    if arguments.virtual and arguments.history is None:
        kept = {key: value for key, value in recorded.facts.items() if key not in HISTORY_FACTS}
        recorded = replace(recorded, facts=kept)
    with writing(arguments.out):
        write_run(absence_facts(recorded), arguments.out)
    print(f"{arguments.out}: {len(recorded)} rows, {_range(recorded)}; {describe_changes(course.changes)}")
    if course.passed_s < experiment.end_s - 0.5 * settings.control.step_s:
        print(f"stopped after {course.passed_s / 60:.0f} of {experiment.end_s / 60:.0f} min")
        return 1
    return 0


def _check_out(path: Path) -> None:
    """Known before hours are spent, not after."""
    if path.exists():
        raise DataError(f"{path}: exists already")
    if not path.parent.is_dir():
        raise DataError(f"{path}: {path.parent} is no folder")


def _controller(arguments: argparse.Namespace, profile: Profile) -> str:
    if profile.is_reference:
        return arguments.controller or "MPC"
    if arguments.controller is not None:
        raise DataError(
            f"{profile.path}: an input profile is applied as it is; --controller is for references"
        )
    return InputProfile.name


@contextmanager
def rig_of(arguments: argparse.Namespace) -> Iterator[tuple[Settings, Clock]]:
    """Yield the rig of the configuration, or a virtual one with files of its own."""
    if not arguments.virtual:
        yield config.load(arguments.config or RIG_CONFIG), RealClock()
        return
    settings = config.default() if arguments.config is None else config.load(arguments.config)
    options = []
    if arguments.chamber is not None:
        read_yaml(dict[str, Any], arguments.chamber)  # else the virtual board would hang or end on it
        options = ["--chamber", str(arguments.chamber)]
    with tempfile.TemporaryDirectory(prefix="greenhouse-experiment-") as temporary:
        folder = Path(temporary)
        placed = settings_in(folder, settings)
        if arguments.history is not None:
            placed = replace(placed, history=replace(placed.history, path=str(arguments.history)))
        with virtual_rig(folder, arguments.seed, options) as rig:
            clock = SimClock(rig.control)
            try:
                yield placed, clock
            finally:
                clock.close()


def _virtual_facts(arguments: argparse.Namespace) -> dict[str, str]:
    if not arguments.virtual:
        return {}
    chamber = {} if arguments.chamber is None else {"chamber": arguments.chamber.name}
    return {"rig": "virtual board", "seed": str(arguments.seed), **chamber}


def _range(run: RecordedRun) -> str:
    from math import isnan

    temps = [value for value in run.columns["temp_air_c"].tolist() if not isnan(value)]
    return f"air {min(temps):.1f} to {max(temps):.1f} degC"
