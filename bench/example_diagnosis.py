"""python -m bench.example_diagnosis: the walk-through of the README, half a minute.

The repo's example runs diagnosed by the command that the README shows: what it prints, the pictures of its
report as files of their own, then the new twin in the place of the old one and the same command again.
With --readme README.md its answer comes into that file anew.
"""

import argparse
import html
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from edge.diagnosis.report.page_style import STYLE

ROOT = Path(__file__).parent.parent
EXAMPLE = Path("docs/examples/diagnosis")
TRAIN, TEST = EXAMPLE / "train_*.csv", EXAMPLE / "test_1.csv"
PICTURES = {
    "diagnosis_run.svg": "test_1.csv",
    "diagnosis_gap.svg": "Error of free runs",
}  # file -> label's begin
PICTURE = re.compile(r'<svg role="img" aria-label="([^"]*)"(.*?)</svg>', re.DOTALL)
ANSWER = re.compile(r"(<!-- diagnosis -->\n```\n).*?(```\n)", re.DOTALL)  # in the README
SECONDS = re.compile(r"^Took .*\n", re.MULTILINE)


def command(twin: Path, report: Path) -> str:
    """As it is typed in the checkout."""
    return f"greenhouse twin diagnose {TRAIN} --test {TEST} --twin {twin} --out {report}"


def walk(folder: Path) -> str:
    """Diagnose, adopt, diagnose; a transcript. folder : for reports and the copy of the twin"""
    lines = []
    twin, report, again = folder / "twin.yaml", folder / "report", folder / "again"
    shutil.copyfile(ROOT / EXAMPLE / "twin.yaml", twin)
    commands = [command(twin, report), f"greenhouse twin adopt {report} --to {twin}", command(twin, again)]
    for words in commands:
        shown = words.replace(str(twin), str(EXAMPLE / "twin.yaml")).replace(f"{folder}/", "out/")
        said = _run(words).replace(str(twin), str(EXAMPLE / "twin.yaml")).replace(f"{folder}/", "out/")
        lines += [f"$ {shown}", SECONDS.sub("", said)]
    return "\n".join(lines)


def with_answer(readme: str, transcript: str) -> str:
    """The README with what the first command prints. Errors: ValueError where its mark is not there"""
    answer = transcript.split("\n$ ")[0].partition("\n")[2].strip() + "\n"
    if not ANSWER.search(readme):
        raise ValueError("the README has no block behind <!-- diagnosis -->")
    return ANSWER.sub(lambda found: found[1] + answer + found[2], readme)


def _run(words: str) -> str:
    """What a command prints. Errors: RuntimeError with what it said"""
    found = [path for word in shlex.split(words)[1:] for path in _expanded(word)]
    done = subprocess.run(
        [sys.executable, "-m", "edge", *found], capture_output=True, text=True, check=False, cwd=ROOT
    )
    if done.returncode != 0:
        raise RuntimeError(f"{words}: {done.stdout}{done.stderr}")
    return done.stdout


def _expanded(word: str) -> list[str]:
    """As a shell does it."""
    return [str(path.relative_to(ROOT)) for path in sorted(ROOT.glob(word))] if "*" in word else [word]


def standalone(page: str) -> Mapping[str, str]:
    """The README's pictures of a report, each as an SVG file of its own on white.

    Errors: ValueError where the report lacks one
    """
    found = {label: rest for label, rest in PICTURE.findall(page)}
    pictures = {}
    for name, begin in PICTURES.items():
        label = next((label for label in found if label.startswith(begin)), None)
        if label is None:
            raise ValueError(f"the report has no picture that begins with {begin!r}: {list(found)}")
        pictures[name] = _on_white(label, found[label])
    return pictures


def _on_white(label: str, rest: str) -> str:
    """In the colours of a light page."""
    root, _, drawing = rest.partition(">")
    for name, colour in re.findall(r"--(\w+): (#\w+)", STYLE.partition("@media")[0]):
        drawing = drawing.replace(f"var(--{name})", colour)
        if name == "ink":
            drawing = drawing.replace("currentColor", colour)
    title = f"<title>{html.escape(html.unescape(label))}</title>"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" role="img"{root}>'
    return f'{head}{title}<rect width="100%" height="100%" fill="#fff"/>{drawing}</svg>\n'


def main(words: Sequence[str] | None = None) -> int:
    """0 when the gap is closed: the second diagnosis finds nothing missing."""
    parser = argparse.ArgumentParser(prog="python -m bench.example_diagnosis", description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "bench/results/example_diagnosis.txt")
    parser.add_argument("--images", type=Path, default=ROOT / "docs/images", help="folder for the pictures")
    parser.add_argument("--readme", type=Path, help="file whose block is written anew")
    arguments = parser.parse_args(words)
    with tempfile.TemporaryDirectory(prefix="greenhouse-example-") as temporary:
        transcript = walk(Path(temporary))
        page = (Path(temporary) / "report" / "report.html").read_text(encoding="utf-8")
    print(transcript)
    arguments.out.write_text(transcript, encoding="utf-8")
    if arguments.readme is not None:
        text = with_answer(arguments.readme.read_text(encoding="utf-8"), transcript)
        arguments.readme.write_text(text, encoding="utf-8")
    for name, text in standalone(page).items():
        (arguments.images / name).write_text(text, encoding="utf-8")
    return int("Nothing is missing" not in transcript)


if __name__ == "__main__":
    sys.exit(main())
