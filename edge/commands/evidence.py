"""`greenhouse evidence`: seal a rig's history day by day, prove such a record, report it by the protocol."""

import argparse
import time
from pathlib import Path

from edge.commands.arguments import add_actions, writing
from edge.commands.bundle import settings_of, store_of
from edge.commands.which_rig import RIG_CONFIG
from edge.config.settings import Settings
from edge.core.errors import RequestError
from edge.evidence.chain import LOCK, extend_chain, rig_facts, seal_chain, start_chain
from edge.evidence.chain_files import ChainDay
from edge.evidence.marks import BEGIN, END, EvidenceMark, add_mark
from edge.evidence.proof import open_record
from edge.evidence.protocol import PHASES
from edge.evidence.record_table import RecordCollector
from edge.evidence.report import proof_lines, report
from edge.formats.atomic_file import write_atomically
from edge.formats.owner import as_owner

ACTIONS = {  # action -> help
    "start": "begin a record: bind the signer, the newest tick and the thresholds",
    "extend": "seal every UTC day that is over; the timer does so each night",
    "mark": "note that a test or a provoked fault begins or ends now",
    "seal": "write the record so far into one signed archive",
    "verify": "prove a sealed archive: order, completeness, nothing changed, who signed",
    "report": "prove a sealed archive and report it against the thresholds",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    action = add_actions(parser, ACTIONS)
    for name in ("start", "extend", "mark", "seal"):
        action[name].add_argument("--config", type=Path, help=f"configuration file (default: {RIG_CONFIG})")
        action[name].add_argument(
            "--folder", type=Path, help="folder of the record; default: evidence, beside the history"
        )
    for name in ("start", "extend", "seal"):
        action[name].add_argument("--key", type=Path, help="private key; default: bundle.signing_key")
    action["mark"].add_argument("what", choices=PHASES, help=f"one of {', '.join(PHASES)}", metavar="WHAT")
    action["mark"].add_argument("edge", choices=(BEGIN, END), help="begin or end")
    action["mark"].add_argument("--text", default="", help="a note, at most 200 characters")
    action["seal"].add_argument("--out", type=Path, required=True, help="archive to write")
    for name in ("verify", "report"):
        action[name].add_argument("archive", type=Path, help="the sealed archive")
        action[name].add_argument("--key", type=Path, help="public key (.pub) that must have signed it")
        action[name].add_argument(
            "--head", action="append", default=[], help="a published head that must be in its chain"
        )
    action["report"].add_argument("--out", type=Path, required=True, help="report to write (HTML)")


def run(arguments: argparse.Namespace) -> int:
    """0 when it is done. Errors: DataError for a record that does not hold, RequestError, ConfigError"""
    match arguments.action:
        case "verify":
            record = open_record(arguments.archive, arguments.key, arguments.head)
            print("\n".join(proof_lines(record)))
        case "report":
            _report(arguments)
        case _:
            settings = settings_of(arguments.config)
            folder = arguments.folder or settings.history.evidence
            with as_owner(folder / LOCK):
                _grow(arguments, settings, folder)
    return 0


def _report(arguments: argparse.Namespace) -> None:
    collector = RecordCollector()
    record = open_record(arguments.archive, arguments.key, arguments.head, collector.see)
    page, lines = report(record, collector.table(record))
    with writing(arguments.out):
        write_atomically(arguments.out, page)
    print("\n".join(lines))
    print(f"{arguments.out}: the report")


def _grow(arguments: argparse.Namespace, settings: Settings, folder: Path) -> None:
    """Start, extend, mark or seal the rig's own record."""
    history, now_utc = Path(settings.history.path), time.time()
    match arguments.action:
        case "mark":
            with writing(folder):
                add_mark(folder, EvidenceMark(now_utc, arguments.what, arguments.edge, arguments.text))
            print(f"{arguments.what} {arguments.edge} is noted; the next extension seals it")
        case "start":
            start = start_chain(folder, history, _key(arguments, settings), now_utc)
            print(f"the record begins after tick {start.after_seq}; signer {start.key_sha256}")
            print("`greenhouse evidence extend` seals each day; publish its head soon")
        case "extend":
            facts = rig_facts(arguments.config or RIG_CONFIG, settings, store_of(settings))
            days, head = extend_chain(folder, history, _key(arguments, settings), facts, now_utc)
            print("\n".join(map(_day_line, days)) or "no day is over that is not sealed")
            print(f"head {head}")
        case _:
            with writing(arguments.out):
                seal = seal_chain(folder, _key(arguments, settings), arguments.out, now_utc)
            print(f"{arguments.out}: {seal.days} days, head {seal.head_sha256}")


def _day_line(day: ChainDay) -> str:
    missing = sum(gap.last_seq - gap.first_seq + 1 for gap in day.gaps)
    return f"{day.date}  {day.ticks} ticks, {missing} missing, {day.rows_bytes / 1e6:.3f} MB"


def _key(arguments: argparse.Namespace, settings: Settings) -> Path:
    """Return the private key that signs. Errors: RequestError"""
    if arguments.key is not None:
        return Path(arguments.key)
    if not settings.bundle.signing_key:
        raise RequestError("no key: make one with `greenhouse bundle key FILE`, and name it by --key")
    return Path(settings.bundle.signing_key)
