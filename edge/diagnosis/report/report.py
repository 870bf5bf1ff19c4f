"""The report of a diagnosis: diagnosis.json for machines, report.html for people."""

from pathlib import Path

from edge.diagnosis.diagnosis_file import FILE_NAME, write_json
from edge.diagnosis.report.page import page
from edge.diagnosis.report.pictures import pictures
from edge.diagnosis.report.story import Story
from edge.formats.atomic_file import write_atomically

PAGE_NAME = "report.html"


def write_report(folder: Path, story: Story) -> None:
    """Write both into `folder`, made where it is not there; without matplotlib the page has no pictures.

    Errors : DataError where the diagnosis is not as its schema says; OSError
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / FILE_NAME, story.document)
    text = page(story.document, pictures(story), str(folder))
    write_atomically(folder / PAGE_NAME, text.encode(errors="backslashreplace"))
