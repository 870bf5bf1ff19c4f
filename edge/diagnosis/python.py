"""The diagnosis from Python: `from edge import Run, Twin, diagnose`.

runs = [Run.read("train_1.csv"), Run.read("train_2.csv")]
found = diagnose(Twin.read("twin.yaml"), runs, tests=[Run.read("test_1.csv")])
print(found)
if found.twin is not None:
    found.twin.write("twin_after.yaml")
"""

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edge.core.errors import DataError
from edge.diagnosis import diagnose as workflow
from edge.diagnosis.answer import answer, traces
from edge.diagnosis.diagnose import Diagnosis
from edge.diagnosis.diagnosis_document import DiagnosisDocument
from edge.diagnosis.experiment.plan import next_experiment
from edge.diagnosis.experiment.sequence import ExperimentLimits
from edge.diagnosis.gap import predict
from edge.diagnosis.progress import Progress
from edge.diagnosis.report.page import PAGE_NAME, write_report
from edge.diagnosis.report.story import Story
from edge.diagnosis.report.summary import summary_text
from edge.diagnosis.runs import NamedRun, diagnosis_runs
from edge.diagnosis.where import Location, locate
from edge.formats import run_file
from edge.formats.run_file import absence_facts
from edge.formats.run_lines import OPTION_WITHOUT, REQUIRED
from edge.formats.table import Table
from edge.twin.twin_file import TwinFile, read_twin_file, write_twin_file

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Run:
    """A recording: columns of equal length, named with their units as in a run file."""

    name: str
    content: run_file.RecordedRun

    @classmethod
    def read(cls, path: str | Path) -> "Run":
        """From a run file, as `greenhouse data convert` writes it. Errors: DataError with file and line"""
        return cls(Path(path).name, run_file.read_run(path, OPTION_WITHOUT))

    @classmethod
    def of(cls, columns: Mapping[str, ArrayLike], name: str = "run", **facts: str) -> "Run":
        """From arrays.

        columns : `time_s` [s], `temp_air_c` [°C], `heater_duty` [0..1]; `fan_on` [0..1] and `temp_ambient_c`
            [°C] where they were recorded; NaN is a missing reading
        facts : `start_utc="2026-07-01T12:00:00Z"`, `role="test"`, ...
        """
        arrays = {key: np.asarray(values, dtype=np.float64) for key, values in columns.items()}
        return cls(name, run_file.RecordedRun(arrays, facts, Path(name)))

    def __len__(self) -> int:
        return len(self.content)

    def _repr_html_(self) -> str:
        rows = [
            (key, f"{np.nanmin(values):.4g}", f"{np.nanmax(values):.4g}", f"{int(np.isnan(values).sum())}")
            for key, values in self.content.columns.items()
        ]
        return f"<b>{html.escape(self.name)}</b>, {len(self)} rows" + _table(
            ("column", "least", "most", "missing"), rows
        )


@dataclass(frozen=True, slots=True)
class Twin:
    """The known facts about a greenhouse, as a twin file states them."""

    file: TwinFile

    @classmethod
    def read(cls, path: str | Path) -> "Twin":
        """Errors: DataError naming the file and the key"""
        return cls(read_twin_file(Path(path)))

    def write(self, path: str | Path) -> None:
        """Errors: OSError"""
        write_twin_file(self.file, Path(path))

    def predict(self, run: Run) -> Floats:
        """Return a free run from the first rows on, with the recorded inputs, [rows] [°C].

        Errors : DataError for a run without a room temperature, or whose rows are not the twin's step apart
        """
        content = run_file.resample(run.content, self.file.sample_s)
        if "temp_ambient_c" not in content.columns:
            raise DataError(f"{run.name}: temp_ambient_c: missing, a prediction needs it")
        named = NamedRun(run.name, content, run.content.columns["time_s"])
        return named.at_rows(predict(self.file, named, content.columns["temp_ambient_c"]))

    def _repr_html_(self) -> str:
        rows = [(".".join(place), str(value.document())) for place, value in self.file.values().items()]
        return _table(("value", "is"), rows)


@dataclass(frozen=True, slots=True, eq=False)
class DiagnosisResult:
    """The result of a diagnosis.

    document : as diagnosis.json has it
    """

    document: DiagnosisDocument
    diagnosis: Diagnosis
    places: Location

    @property
    def verdict(self) -> str:
        """`named`, `nothing_missing` or `unknown`."""
        return str(self.document["verdict"])

    @property
    def names(self) -> dict[str, float]:
        """Return the missing effects and the probability that each is one, most important first."""
        return {effect.name: effect.probability for effect in self.diagnosis.verdict.effects}

    @property
    def twin(self) -> Twin | None:
        """The new twin, None where none is worth adopting; `document["against_adopting"]` says why."""
        return Twin(self.diagnosis.adopted) if self.diagnosis.is_offered else None

    def report(self, folder: str | Path) -> Path:
        """Write the report's page with its pictures and diagnosis.json; the page. Errors: OSError"""
        where = Path(folder)
        write_report(where, Story(self.document, traces(self.diagnosis, self.places)))
        return where / PAGE_NAME

    def __str__(self) -> str:
        return summary_text(self.document)

    def _repr_html_(self) -> str:
        rows = [(name, f"{probability:.2f}") for name, probability in self.names.items()]
        return _table(("missing", "probability"), rows) + f"<pre>{html.escape(str(self))}</pre>"


def diagnose(
    twin: Twin,
    runs: Sequence[Run],
    tests: Sequence[Run] = (),
    progress: Progress | None = None,
) -> DiagnosisResult:
    """Find where a twin disagrees with recordings, name the missing effect, and fit the twin with it.

    runs : to fit on; tests : to judge by, which may be empty
    progress : is told what is done now, and the share that is done by then
    Errors : DataError naming a run and its column
    """
    data = diagnosis_runs(
        [(run.name, _complete(run)) for run in runs], [(run.name, _complete(run)) for run in tests], twin.file
    )
    found = workflow.diagnose(twin.file, data, progress or (lambda text, share: None), "edge.diagnose")
    places = locate(found)
    experiment = next_experiment(found, ExperimentLimits(heater_w=twin.file.geometry["heater_max_w"].value))
    return DiagnosisResult(answer(found, places, "edge.diagnose", experiment), found, places)


def _complete(run: Run) -> run_file.RecordedRun:
    """Return the recording with facts that say what was not recorded. Errors: DataError"""
    known = {*run.content.columns, *OPTION_WITHOUT}
    if missing := [key for key in REQUIRED if key not in known]:
        raise DataError(f"{run.name}: {missing[0]}: missing")
    return absence_facts(run.content)


def _table(heads: tuple[str, ...], rows: Sequence[Sequence[str]]) -> str:
    return "".join(Table("", heads, tuple(map(tuple, rows))).html())
