"""`greenhouse commission`: step tests, a twin of this box, and a bundle that controls it.

The tests take the board, so the daemon must not run meanwhile. `p` and Enter pauses them while hands are in
the box, `g` and Enter goes on; so does `greenhouse maintenance`. Ctrl-C or SIGTERM ends them early, and what
is recorded by then is used; --go-on records the rest later, --from-run learns from a recording again.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from edge.app.box import BEFORE, COMMISSION, description_of
from edge.commands.arguments import number, whole, writing
from edge.commands.bundle import change, install, settings_of, store_of
from edge.commands.experiment import rig_of
from edge.commands.hands import Hands
from edge.config.settings import BoxSettings, Settings
from edge.core.controller_names import MPC_TWIN
from edge.core.errors import DataError, RequestError
from edge.core.messages import TickRecord
from edge.diagnosis.progress import TerminalProgress
from edge.formats.atomic_file import make_folder, write_atomically, write_document
from edge.formats.owner import as_owner
from edge.formats.reader import read_bytes
from edge.formats.run_file import RecordedRun, absence_facts, read_run, write_run
from edge.sockets.client import NobodyListens, request
from edge.twin.twin_file import TwinFile, read_twin_file, write_twin_file

if TYPE_CHECKING:
    from edge.app.commission import Commissioned

CONTROLLER = MPC_TWIN[-1]
SHORTEST_MIN = 20.0
CHOSEN_STEPS, CHOSEN_LOOK_S = 3.0, 2.0  # for a daemon to take up the bundle, and between two looks [s]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--twin", type=Path, help="twin file that describes the box; default: box.twin")
    parser.add_argument(
        "--minutes",
        type=number(SHORTEST_MIN),
        default=120.0,
        help="length of the step tests; default: %(default)g, a heavy box needs more",
    )
    parser.add_argument(
        "--from-run", type=Path, metavar="RUN", help="learn from this recording, make no tests"
    )
    parser.add_argument(
        "--go-on",
        type=Path,
        metavar="FOLDER",
        help="record the rest of tests that ended early, of this --out",
    )
    parser.add_argument("--out", type=Path, help="folder for run and twin; default: commissioning-DATE")
    parser.add_argument("--key", type=Path, help="private key that signs; default: bundle.signing_key")
    parser.add_argument(
        "--only-learn", action="store_true", help="write the twin, but sign and activate no bundle"
    )
    parser.add_argument("--config", type=Path, help="configuration file; default: the rig's")
    parser.add_argument("--virtual", action="store_true", help="try it on a virtual board")
    parser.add_argument("--seed", type=whole(0), default=1, help="of the virtual board's noise; default: 1")
    parser.set_defaults(chamber=None, history=None)


def run(arguments: argparse.Namespace) -> int:
    """0 when the box is commissioned, 1 when it is refused; the reasons are printed."""
    from edge.app.commission import learn  # late: scipy
    from edge.app.step_test_record import STEP_S
    from edge.app.step_test_rows import LEARN_MIN, STOPPED

    settings = settings_of(arguments.config)
    start = _start(arguments, settings)
    key = None if arguments.only_learn or arguments.virtual else _key(arguments.key, settings)
    dated = Path(f"commissioning-{datetime.now(UTC):%Y-%m-%d_%H%M}")
    folder = arguments.go_on or arguments.out or dated
    with writing(folder):
        make_folder(folder)
    recorded = read_run(arguments.from_run) if arguments.from_run else _record(arguments, start, folder)
    if recorded.facts.get(STOPPED) and not arguments.from_run:
        raise RequestError(
            f"the tests were stopped: {recorded.facts[STOPPED]}. {_later(folder)} when the cause is gone"
        )
    minutes = len(recorded) * STEP_S / 60.0
    if minutes < LEARN_MIN:
        later = "" if arguments.from_run else f"; {_later(folder)}"
        raise RequestError(f"{minutes:.0f} min are recorded, {LEARN_MIN:g} is the least to learn from{later}")
    with TerminalProgress() as progress:
        found = learn(recorded, start, settings.control, progress)
    with writing(folder):
        write_twin_file(found.twin, folder / "twin.yaml")
    print("\n".join(describe(found)))
    if found.refusals:
        return 1
    print(f"{folder / 'twin.yaml'}: the twin of this box")
    if key is not None:
        _activate(found, folder, key, settings)
    return 0


def describe(found: "Commissioned") -> Iterator[str]:
    """Yield what was learned and what to expect of it, or why it is refused."""
    expected = found.expectation
    yield f"missing in a plain box, and added: {', '.join(found.names) or 'nothing'}"
    yield f"over rows that no fit saw, free runs are off by {expected.error_k:.2f} K"
    if found.better is not None:
        name, error_k = found.better
        yield f"{name} is off by {error_k:.2f} K: the twin lacks something, which longer tests may show"
    reach = f"{expected.reach_c:.0f} °C"
    if expected.reach_c > expected.seen_c + 1.0:
        reach = f"more than {expected.seen_c:.0f} °C, the warmest of these tests"
    yield (
        f"in a room of {expected.room_c:.1f} °C, {expected.hours:.1f} h of full heat reach {reach}; "
        f"to hold takes {expected.hold_w_k:.1f} W then for each K over the room"
    )
    yield "what days of heat come to, longer tests or a night of the history tell"
    if expected.fanned_c == expected.fanned_c:
        yield f"the fan alone brings the air to {expected.fanned_c:.1f} °C"
    yield from found.doubts
    for reason in found.refusals:
        yield f"refused: {reason}"
    if found.refusals:
        yield "the box is not commissioned: another controller than rules would be a guess"


def _start(arguments: argparse.Namespace, settings: Settings) -> TwinFile:
    """Return the description of the box. Errors: RequestError where there is none"""
    path = arguments.twin or (Path(settings.box.twin) if settings.box.twin else None)
    if path is None:
        raise RequestError("no description of the box: `greenhouse setup` or `greenhouse twin new` makes one")
    return description_of(path)


def _key(given: Path | None, settings: Settings) -> Path:
    """Known before hours are spent, not after. Errors: RequestError"""
    if given is None and not settings.bundle.signing_key:
        raise RequestError(
            "no key to sign with: --key FILE or bundle.signing_key. `greenhouse bundle key FILE` makes one; "
            f"its public half goes into {settings.bundle.trusted_keys}"
        )
    return given or Path(settings.bundle.signing_key)


def _record(arguments: argparse.Namespace, start: TwinFile, folder: Path) -> RecordedRun:
    from edge.app.step_test_record import STEP_S, record, test_settings

    path = folder / "run.csv"
    if path.exists() and not arguments.go_on:
        raise RequestError(f"{path}: exists already; --from-run {path} learns from it, {_later(folder)}")
    before = read_run(path) if arguments.go_on else None
    minutes = arguments.minutes - (0.0 if before is None else len(before) * STEP_S / 60.0)
    if minutes <= 0.0:
        raise RequestError(f"{path}: has {arguments.minutes:g} min already; --from-run {path} learns from it")

    with tempfile.TemporaryDirectory(prefix="greenhouse-commission-") as temporary:
        # The description, not a twin of an earlier box: safety asks of it what it knows.
        box = Path(temporary) / "twin.yaml"
        write_twin_file(start, box)
        with rig_of(arguments) as (settings, clock), Hands(Path(settings.control_socket.path), print):
            settings = test_settings(replace(settings, box=BoxSettings(str(box))))
            has_fan = start.fan_role != "none"
            save = partial(save_run, path, before)
            recorded = save(record(settings, clock, has_fan, minutes, _Show(), save=save))
    print(f"{path}: {len(recorded)} rows; should learning fail, --from-run {path} tries again")
    return recorded


def save_run(path: Path, before: RecordedRun | None, run: RecordedRun) -> RecordedRun:
    """Write a recording behind the one before it; return both as one. Errors: DataError"""
    from edge.app.step_test_rows import join

    whole = run if before is None else join(before, run)
    with writing(path):
        write_run(absence_facts(whole), path)
    return whole


def _later(folder: Path) -> str:
    return f"--go-on {folder} records the rest"


def keep(twin: TwinFile, place: Path) -> None:
    """Put the learned twin where safety looks for the box's bounds; the description stays beside it."""
    before = place.with_name(place.name + BEFORE)
    with writing(place):
        # A description in its place is newer than the one beside it: setup has asked for the box again.
        if place.exists() and (not before.exists() or read_twin_file(place).to_fit()):
            write_atomically(before, read_bytes(place))
        write_twin_file(twin, place)
    print(f"{place}: the learned twin, from which safety takes its bounds; the description is {before}")


class _Show:
    """Print a line where a leg begins."""

    def __init__(self) -> None:
        self._leg = ""

    def __call__(self, tick: TickRecord, minutes_left: float) -> None:
        leg = str(tick.decision.why.get("leg", tick.decision.controller))
        if leg != self._leg:
            self._leg = leg
            air = tick.readings["temp_air"].value
            shown = "  ?  " if air is None else f"{air:5.1f}"
            print(f"{minutes_left:4.0f} min left  air {shown} °C  {leg}", flush=True)


def _activate(found: "Commissioned", folder: Path, key: Path, settings: Settings) -> None:
    """Sign a bundle of the twin and its fallback, make it the active one and its planner the controller."""
    from edge.bundle.archive import open_archive
    from edge.bundle.sign import ManifestFacts, build_bundle
    from edge.models.arx_file import write_arx

    now = time.time()
    models, archive = folder / "models", folder / "bundle.zip"
    with writing(folder):
        make_folder(models)
        write_twin_file(found.twin, models / "twin.yaml")
        if found.arx is not None:
            write_arx(found.arx.model, models / "arx.json", {"command": COMMISSION})
    facts = ManifestFacts(
        version=f"{datetime.fromtimestamp(now, UTC):%Y.%m%d.%H%M}-commissioned",
        created_utc=f"{datetime.fromtimestamp(now, UTC):%Y-%m-%dT%H:%M:%SZ}",
        data_sha256=str(found.twin.provenance["data_sha256"]),
        sample_s=settings.control.step_s,
    )
    manifest = build_bundle(models, archive, facts, key)
    store = store_of(settings)
    with open_archive(archive) as file:
        install(store, settings, file)
    change(store, settings, "activate", manifest.version)
    if settings.box.twin:
        try:
            keep(found.twin, Path(settings.box.twin))
        except DataError as error:  # the service may not write there: bounds of a described box stay in force
            print(f"{error}; safety keeps the bounds of the description")
    _choose(settings)


def _choose(settings: Settings) -> None:
    """Make the twin's planner the controller, by the daemon where one runs. Errors: RequestError"""
    from edge.state.store import STANDING, restore

    give_up_s = time.monotonic() + CHOSEN_STEPS * settings.control.step_s
    while True:
        try:
            reply = request(Path(settings.control_socket.path), {"do": "set_controller", "name": CONTROLLER})
        except NobodyListens:
            break
        if reply.get("ok"):
            print(f"{CONTROLLER} controls")
            return
        if time.monotonic() > give_up_s:  # the daemon takes up a bundle at its next tick
            raise RequestError(f"{CONTROLLER} is not chosen: {reply.get('error', reply)}")
        time.sleep(CHOSEN_LOOK_S)
    standing = restore(STANDING, settings)
    if standing.broken:  # a stop may be in it: nothing is written over it
        raise RequestError(f"{standing.broken}: choose `greenhouse controller {CONTROLLER}` yourself")
    chosen = replace(standing, operation=replace(standing.operation, controller=CONTROLLER))
    place = STANDING.place(settings)
    with as_owner(place):  # root may have a umask that shuts the daemon out
        write_document(place, STANDING.encode(chosen))
    print(f"{CONTROLLER} controls from the daemon's next start on: `sudo systemctl start greenhouse`")
