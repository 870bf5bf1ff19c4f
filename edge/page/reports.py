"""Reports of diagnoses as the page shows them. Each may be half-written, of another version, or hostile.

A report is a folder in `drift.reports`. Its name is one of the folder's listing, so no path leads elsewhere;
its diagnosis is read with a limit and checked against its schema before a word of it is used.
"""

import os
import shlex
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

from edge.bundle.manifest import FILE_NAME as NAME
from edge.core.errors import DataError
from edge.core.plain_text import plain
from edge.diagnosis.diagnosis_document import DiagnosisDocument, EffectEntry, NextExperiment
from edge.diagnosis.diagnosis_file import FILE_NAME, check_diagnosis
from edge.diagnosis.report import wording
from edge.diagnosis.report.number_text import duration, kelvin, percent
from edge.formats.input_file import open_file, read_file
from edge.formats.reader import parse_json, read_bytes

Json = dict[str, Any]

REPORTS_MAX = 30  # shown, the newest ones; the nights keep as many
DOCUMENT_MAX = 1 << 20  # bytes; the values of it take ten times as much
HTML_MAX = 8 << 20  # bytes
FINDINGS_MAX = 3  # of where it disagrees; the whole report has more
LOG_MAX = 4096  # bytes of a log's end
TEXT_MAX = 600  # characters of a sentence
HTML, LOG, PROFILE = "report.html", "log.txt", "next_experiment.csv"


def summaries(reports: Path) -> list[Json]:
    """Return the verdict of each report in a sentence, the newest first. Errors: DataError"""
    found = [(_change_utc(reports / name), name) for name in names(reports)]
    return [_summary(reports / name, utc) for utc, name in sorted(found, reverse=True)[:REPORTS_MAX]]


def names(reports: Path) -> list[str]:
    """Return the reports of a folder, none where it does not exist yet. Errors: DataError"""
    try:
        with os.scandir(reports) as entries:
            folders = [entry for entry in entries if NAME.fullmatch(entry.name)]
            return [entry.name for entry in folders if entry.is_dir(follow_symlinks=False)]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise DataError(f"{reports}: {error.strerror}") from error


def details(report: Path) -> Json:
    """Return what the page shows of one report. Errors: DataError"""
    document = _document(report)
    return {
        **_summary(report, _change_utc(report)),
        "meaning": _lines([*wording.meaning(document), *wording.cautions(document)]),
        "where": _lines(wording.where(document)[:FINDINGS_MAX]),
        "figures": _figures(document),
        "effects": [_effect(effect) for effect in document["effects"]],
        "predicting": _lines(wording.predicting(document)),
        "against": _lines(document.get("against_adopting", [])),
        "experiment": _experiment(report, experiment)
        if (experiment := document["next_experiment"])
        else None,
    }


def html(report: Path) -> bytes:
    """Return the report for people; whoever serves it must let nothing in it act. Errors: DataError"""
    if not _is_plain(report / HTML):
        raise DataError(f"{report.name}: has no {HTML}")
    try:
        return read_file(report / HTML, HTML_MAX)
    except OSError as error:
        raise DataError(f"{report.name}: {HTML}: {error.strerror}") from error


def _summary(report: Path, utc: float) -> Json:
    known: Json = {
        "name": report.name,
        "utc": utc,
        "headline": "",
        "gap": "",
        "problem": "",
        "has_twin": False,
    }
    known["has_html"] = _is_plain(report / HTML)
    path = report / FILE_NAME
    if not path.exists():
        said = _last_line(report / LOG)
        words = "No result: it is under way, or ended without one."
        return known | {"problem": f"{words} Last said: {said}" if said else words}
    try:
        status = path.lstat()
        return known | _verdict(report, status.st_mtime_ns, status.st_size)
    except (DataError, OSError) as error:
        return known | {"problem": plain(str(error), TEXT_MAX)}


@lru_cache(maxsize=2 * REPORTS_MAX)
def _verdict(report: Path, mtime_ns: int, size: int) -> Json:
    """Return a diagnosis's verdict. mtime_ns, size : of its file, by which it is known. Errors: DataError"""
    document = _document(report)
    name = wording.new_twin(document)
    return {
        "verdict": document["verdict"],
        "headline": plain(wording.headline(document), TEXT_MAX),
        "gap": plain(wording.gap_sentence(document), TEXT_MAX),
        "has_twin": name is not None and bool(NAME.fullmatch(name)) and _is_plain(report / name),
    }


def _document(report: Path) -> DiagnosisDocument:
    """Errors: DataError where it is not a diagnosis."""
    path = report / FILE_NAME
    if path.is_symlink():
        raise DataError(f"{report.name}: {FILE_NAME} is a link")
    document = parse_json(read_bytes(path, DOCUMENT_MAX), f"{report.name}: {FILE_NAME}", DOCUMENT_MAX)
    check_diagnosis(document)
    return cast(DiagnosisDocument, document)


def _figures(document: DiagnosisDocument) -> list[list[str]]:
    """Return a row for each role with an error: errors before and after, noise floor [K], closed share."""
    changed = wording.is_changed(document)
    return [
        _lines(
            [
                words,
                kelvin(wording.rmse_k(document, "before", role)),
                kelvin(wording.rmse_k(document, "after", role) if changed else None),
                kelvin(document["gap"]["noise_floor"][role]),
                percent(wording.shrink(document, role) if changed else None),
            ]
        )
        for role, words in wording.ROLES.items()
        if wording.rmse_k(document, "before", role) is not None
    ]


def _effect(effect: EffectEntry) -> Json:
    name, equation, evidence = wording.effect_lines(effect)
    text = ": ".join(filter(None, [name, equation]))
    return {"text": plain(text, TEXT_MAX), "evidence": _lines(evidence)}


def _experiment(report: Path, experiment: NextExperiment) -> Json:
    """Return the next experiment in words, and the commands that run it: the daemon has no order for it."""
    profile = report / PROFILE
    commands = [
        "sudo systemctl stop greenhouse",
        f"sudo -u greenhouse greenhouse experiment {shlex.quote(str(profile))} --out /tmp/next_run.csv",
        "sudo systemctl start greenhouse",
    ]
    return {
        "why": _lines([experiment["why"], *experiment.get("asks", [])]),
        "takes": duration(experiment["duration_s"]),
        "commands": commands if _is_plain(profile) else [],
    }


def _lines(texts: list[str]) -> list[str]:
    return [plain(text, TEXT_MAX) for text in texts]


def _change_utc(report: Path) -> float:
    """Return when its diagnosis was written, or else its folder changed [s since 1970]."""
    for path in (report / FILE_NAME, report):
        try:
            return round(path.lstat().st_mtime, 3)
        except OSError:
            continue
    return 0.0


def _is_plain(path: Path) -> bool:
    """Return whether it is a file of the report: a link may lead to what only this process may read."""
    return path.is_file() and not path.is_symlink()


def _last_line(log: Path) -> str:
    """Return the log's last line, "" where it says nothing."""
    if not _is_plain(log):
        return ""
    try:
        with open_file(log) as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - LOG_MAX))
            lines = file.read(LOG_MAX).decode(errors="replace").strip().splitlines()
    except OSError:
        return ""
    return plain(lines[-1], TEXT_MAX) if lines else ""
