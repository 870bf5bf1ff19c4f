"""python -m bench.example_diagnosis: the walk-through of the manual, half a minute.

The repo's example runs diagnosed by the command that docs/whats-missing.md shows: what it prints and the
pictures of its report as files of their own. Then the new twin takes the place of the old one, and the same
command runs again. Also the README's picture. With --page docs/whats-missing.md its answer comes into that
file anew.
"""

import argparse
import html
import json
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from edge.diagnosis.report.markup import STYLE
from edge.formats.run_file import read_run

ROOT = Path(__file__).parent.parent
EXAMPLE = Path("docs/examples/diagnosis")
TRAIN, TEST = EXAMPLE / "train_*.csv", EXAMPLE / "test_1.csv"
PICTURES = {
    "diagnosis_run.svg": "test_1.csv",
    "diagnosis_gap.svg": "Error of free runs",
}  # file -> label's begin
PICTURE = re.compile(r'<svg role="img" aria-label="([^"]*)"(.*?)</svg>', re.DOTALL)
ANSWER = re.compile(r"(<!-- diagnosis -->\n```\n).*?(```\n)", re.DOTALL)  # in the manual


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
        lines += [f"$ {shown}", said]
    return "\n".join(lines)


def with_answer(page: str, transcript: str) -> str:
    """Return the page with the first command's output. Errors: ValueError where its mark is missing"""
    answer = transcript.split("\n$ ")[0].partition("\n")[2].strip() + "\n"
    if not ANSWER.search(page):
        raise ValueError("the page has no block behind <!-- diagnosis -->")
    return ANSWER.sub(lambda found: found[1] + answer + found[2], page)


def _run(words: str) -> str:
    """Return a command's output. Errors: RuntimeError with its messages"""
    found = [path for word in shlex.split(words)[1:] for path in _expand(word)]
    done = subprocess.run(
        [sys.executable, "-m", "edge", *found], capture_output=True, text=True, check=False, cwd=ROOT
    )
    if done.returncode != 0:
        raise RuntimeError(f"{words}: {done.stdout}{done.stderr}")
    return done.stdout


def _expand(word: str) -> list[str]:
    """As a shell does it."""
    return [str(path.relative_to(ROOT)) for path in sorted(ROOT.glob(word))] if "*" in word else [word]


def standalone(page: str) -> Mapping[str, str]:
    """Return the report's pictures for the manual, each as an SVG file of its own on white.

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


def draw_overview(report: Path, picture: Path) -> None:
    """Draw the held-out run twice: with the twin as it was, and with the twin of the report."""
    import matplotlib.pyplot as plt  # late: a report of text alone needs none

    document = json.loads((report / "diagnosis.json").read_text(encoding="utf-8"))
    names = ", ".join(effect["name"].replace("_", " ") for effect in document["effects"])
    measured = read_run(ROOT / TEST)
    time_min = measured.columns["time_s"] / 60.0
    with plt.rc_context({"svg.hashsalt": "overview", "font.size": 11, "svg.fonttype": "path"}):
        figure, axes = plt.subplots(1, 2, figsize=(7.4, 3.5), sharey=True, layout="constrained")
        sides = (
            ("twin_before.yaml", "before", "Before the diagnosis", "#c2500a"),
            ("twin.yaml", "after", f"After: {names} added", "#0f72b8"),
        )
        # Through the command that a reader would type, so that the picture shows what they would get.
        for axis, (file, when, title, colour) in zip(axes, sides, strict=True):
            free = report / f"free_{when}.csv"
            _run(f"greenhouse twin simulate --twin {report / file} {TEST} --out {free}")
            error_k = document["gap"][when]["test"]["rmse_k"]
            axis.plot(time_min, measured.columns["temp_air_c"], color="#9aa3ab", lw=5, label="measured")
            axis.plot(time_min, read_run(free).columns["predicted_c"], color=colour, lw=2, label="twin")
            axis.set_title(f"{title}\nerror {error_k:.2g} K", loc="left", fontsize=11, fontweight="bold")
            axis.set_xlabel("time [min]")
            axis.spines[["top", "right"]].set_visible(False)
            axis.legend(loc="upper left", frameon=False)
        axes[0].set_ylabel("air in the greenhouse [°C]")
        figure.savefig(picture, metadata={"Date": None}, facecolor="white")
        plt.close(figure)


def main(words: Sequence[str] | None = None) -> int:
    """0 when the gap is closed: the second diagnosis finds nothing missing."""
    parser = argparse.ArgumentParser(prog="python -m bench.example_diagnosis", description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "bench/results/example_diagnosis.txt")
    parser.add_argument("--images", type=Path, default=ROOT / "docs/images", help="folder for the pictures")
    parser.add_argument("--page", type=Path, help="file whose block is written anew")
    arguments = parser.parse_args(words)
    with tempfile.TemporaryDirectory(prefix="greenhouse-example-") as temporary:
        transcript = walk(Path(temporary))
        report = Path(temporary) / "report"
        page = (report / "report.html").read_text(encoding="utf-8")
        draw_overview(report, arguments.images / "overview.svg")
    print(transcript)
    arguments.out.write_text(transcript, encoding="utf-8")
    if arguments.page is not None:
        text = with_answer(arguments.page.read_text(encoding="utf-8"), transcript)
        arguments.page.write_text(text, encoding="utf-8")
    for name, text in standalone(page).items():
        (arguments.images / name).write_text(text, encoding="utf-8")
    return int("Nothing is missing" not in transcript)


if __name__ == "__main__":
    sys.exit(main())
