"""`greenhouse twin adopt REPORT`: the twin that a diagnosis found becomes the running one, or that is undone.

On a rig it goes the way of every model: a bundle like the active one with the new twin, signed, beside the
active one in shadow (--activate: in its place, on probation). The key that signs is named, never made on
the way: `greenhouse bundle key FILE` makes one, and whoever has root puts its public half among the rig's
trusted keys. Without a rig, --to replaces a twin file and keeps the one before.
"""

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

from edge.bundle.adopt import AdoptedBundle, with_twin
from edge.bundle.archive import open_archive, pack
from edge.bundle.manifest import FILE_NAME
from edge.commands.arguments import writing
from edge.commands.bundle import change, install, settings_of, store_of
from edge.config.settings import Settings
from edge.core.errors import DataError, RequestError
from edge.core.names import SIGNALS
from edge.core.plain_text import plain, quote
from edge.formats.atomic_file import move, write_atomically
from edge.formats.cross_check import Rule
from edge.formats.input_file import MODEL
from edge.formats.reader import Foreign, read_bytes, read_json
from edge.models.pbm import read_twin

DIAGNOSIS, TWIN = "diagnosis.json", "twin.yaml"
BEFORE = ".before"  # ending of the file that --to has replaced


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the action."""
    parser.add_argument("report", nargs="?", type=Path, help="folder of a diagnosis, or a twin file")
    parser.add_argument("--back", action="store_true", help="instead: undo the last adoption")
    how = parser.add_mutually_exclusive_group()
    how.add_argument(
        "--shadow", action="store_true", help="run beside the active bundle and be scored; the default"
    )
    how.add_argument("--activate", action="store_true", help="take its place, on probation")
    how.add_argument(
        "--bundle-out", type=Path, metavar="FILE", help="write the signed bundle, install nothing"
    )
    how.add_argument("--to", type=Path, metavar="FILE", help="replace this twin file, save the one before")
    parser.add_argument("--key", type=Path, help="private key that signs; default: bundle.signing_key")
    parser.add_argument(
        "--config",
        type=Path,
        help="configuration file; default: the rig's where there is one, else every setting's default",
    )


def run(arguments: argparse.Namespace) -> int:
    """0 when it is done; what is refused is told in one line and has changed nothing."""
    if arguments.back == (arguments.report is not None):
        raise RequestError("give the folder of a diagnosis, or --back")
    if arguments.back:
        _back(arguments)
    elif arguments.to is not None:
        _replace(reported_twin(arguments.report), arguments.to)
    else:
        _adopt(reported_twin(arguments.report), arguments)
    return 0


@dataclass(frozen=True, slots=True)
class ReportedTwin(Foreign):
    """Part of diagnosis.json: the twin's file and why it may not be used."""

    twin_after: Annotated[str, Rule(pattern=FILE_NAME.pattern)] | None = TWIN
    against_adopting: tuple[str, ...] = ()
    verdict: str = ""


def reported_twin(report: Path) -> Path:
    """Return the twin file of a report. Errors: DataError where none is there, or nothing was found"""
    if report.is_file():
        read_twin(report)
        return report
    if not (report / DIAGNOSIS).exists():
        raise DataError(f"{report / DIAGNOSIS}: does not exist: is this the folder of a diagnosis?")
    found = read_json(ReportedTwin, report / DIAGNOSIS, MODEL)
    name = found.twin_after
    if name is None:
        why = [*found.against_adopting, f"the verdict is {found.verdict}"][0]
        raise DataError(f"{report / DIAGNOSIS}: there is no twin to adopt: {plain(why, 200)}")
    if not (report / name).is_file():
        raise DataError(f"{report / DIAGNOSIS}: twin_after: {quote(name)} is not a file of the report")
    twin = report / name
    read_twin(twin)
    return twin


def _adopt(twin: Path, arguments: argparse.Namespace) -> None:
    settings = settings_of(arguments.config)
    store = store_of(settings)
    with tempfile.TemporaryDirectory(prefix="greenhouse-twin-") as temporary:
        folder = Path(temporary)
        adopted = with_twin(store, twin, _changes(twin), _key(arguments.key, settings), folder)
        _refuse_without_planner(adopted, settings, arguments.bundle_out is not None)
        if arguments.bundle_out is not None:
            with writing(arguments.bundle_out):
                write_atomically(arguments.bundle_out, pack(folder))
            print(f"{arguments.bundle_out}: bundle {adopted.manifest.version}, signed")
        else:
            with open_archive(folder) as archive:
                install(store, settings, archive)
    print("\n".join(_in_words(adopted, twin, settings.control.predictor)))
    if arguments.activate:
        change(store, settings, "activate", adopted.manifest.version)


def _key(given: Path | None, settings: Settings) -> Path:
    if given is not None:
        return given
    if not settings.bundle.signing_key:
        raise RequestError(
            "no key to sign with: --key FILE or bundle.signing_key. `greenhouse bundle key FILE` makes one; "
            f"its public half goes into {settings.bundle.trusted_keys}"
        )
    return Path(settings.bundle.signing_key)


def _refuse_without_planner(adopted: AdoptedBundle, settings: Settings, elsewhere: bool) -> None:
    """Refuse a twin without which a rig that plans with the hybrid would lack its model."""
    if not elsewhere and settings.control.predictor in adopted.dropped and not settings.control.model:
        name = settings.control.predictor
        raise RequestError(
            f"control.predictor is {name}, and this rig's {name} was trained on the twin before: plan with "
            "another model first, or train the hybrid anew and install that bundle"
        )


def _in_words(adopted: AdoptedBundle, twin: Path, predictor: str) -> Iterator[str]:
    yield f"{adopted.manifest.version} is bundle {adopted.base} with {twin}"
    if "ham" in adopted.dropped:
        yield (
            "ham is left out, it corrects the twin before; "
            f"`greenhouse-train ham --twin {twin}` trains it on this one"
        )
    for column, effect in read_twin(twin).twin.needs.items():
        if column in SIGNALS:
            yield f"{effect} needs {SIGNALS[column].key}: without it the twin forecasts nothing"
    if predictor != "pbm":
        yield f"the MPC plans with {predictor}; `control: {{predictor: pbm}}` makes it plan with the twin"


def _back(arguments: argparse.Namespace) -> None:
    if arguments.to is not None:
        before = _before(arguments.to)
        if not before.exists():
            raise RequestError(f"{before}: is not there, so nothing was replaced")
        with writing(arguments.to):
            move(before, arguments.to)
        print(f"{arguments.to}: as before")
        return
    settings = settings_of(arguments.config)
    change(store_of(settings), settings, "undo-adoption", None)


def _replace(twin: Path, target: Path) -> None:
    """Replace `target` atomically: a reader sees either file whole."""
    with writing(target):
        if target.exists():
            if target.resolve() == twin.resolve():
                raise RequestError(f"--to: {target} is the file of the report itself")
            write_atomically(_before(target), read_bytes(target))
        write_atomically(target, read_bytes(twin))
    kept = f"; the one before is {_before(target)}" if _before(target).exists() else ""
    print(f"{target}: {twin}{kept}")


def _before(target: Path) -> Path:
    return target.with_name(target.name + BEFORE)


def _changes(path: Path) -> str:
    return datetime.fromtimestamp(int(path.stat().st_mtime), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
