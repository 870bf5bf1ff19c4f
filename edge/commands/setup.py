"""`greenhouse setup`: find the board, check its outputs, ask for the box, write edge.yaml and a twin file.

Each answer is saved at once, so that an interrupted setup goes on where it was.
"""

import argparse
import difflib
import os
import re
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path

from edge.app import setup
from edge.app.setup import QUESTIONS, BoxQuestion, OutputResult, SetupAnswers, answer, next_question
from edge.board.board_session import BoardSession
from edge.board.board_tool import give_own_id, show
from edge.board.output_check import CHECKS, LEASE_S, OutputRefused, outputs, run_check, suited_check
from edge.board.serial_port import find_ports, lasting_name
from edge.commands.arguments import add_config, writing
from edge.commands.check_config import problems
from edge.config import loading
from edge.config.example import changed_keys
from edge.config.settings import BoxSettings, Settings
from edge.core.errors import ConfigError, RequestError

WIDTH = 79  # columns of text, so that no line wraps in a terminal of 80
NO_BREAK = "\N{NO-BREAK SPACE}"  # at which textwrap breaks no line
INTERRUPTED = 130  # exit code of every command that Ctrl-C ends


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_config(parser)
    parser.add_argument("--port", help="serial port of the board (default: searched for)")
    parser.add_argument("--anew", action="store_true", help="forget the answers of an interrupted setup")
    parser.add_argument(
        "--from-answers",
        type=Path,
        metavar="FILE",
        help="ask nothing: take the answers from a JSON file such as setup.json; checks no output",
    )
    parser.add_argument(
        "--replace",
        action="store_true",
        help="with --from-answers: keep files that differ under another name",
    )


def run(arguments: argparse.Namespace) -> int:
    """0 when the files are written. Errors: ConfigError, DataError, RequestError"""
    config: Path = arguments.config
    _check_folder(config.absolute().parent)
    before = loading.load(config) if config.exists() else loading.default()
    if arguments.from_answers is not None:
        _run_unattended(arguments, before)
        return 0
    saved = config.with_name("setup.json")
    kept = f"The answers so far are in {saved}; the same command goes on there."
    try:
        SetupDialogue(config, saved, before, arguments).hold()
    except EOFError:
        raise RequestError(f"standard input has ended. {kept}") from None
    except KeyboardInterrupt:
        say(f"Interrupted; no output is driven. {kept}")
        return INTERRUPTED
    return 0


def say(text: str) -> None:
    """Print a paragraph within 80 columns; a command between backticks stays on one line."""
    whole = re.sub("`.*?`", lambda command: command[0].replace(" ", NO_BREAK), text)
    lines = textwrap.fill(whole, WIDTH, break_long_words=False, break_on_hyphens=False)
    print(lines.replace(NO_BREAK, " "), flush=True)


def ask(text: str, choices: Sequence[str] = ()) -> str:
    """Return a line, or the choice that it begins. Errors: EOFError at the end of standard input"""
    print()
    say(text + (f" ({', '.join(choices)})" if choices else ""))
    while True:
        words = input("> ").strip()
        matches = [choice for choice in choices if words and choice.startswith(words.lower())]
        if not choices or len(matches) == 1:
            return matches[0] if choices else words
        say(f"Please type one of: {', '.join(choices)}")


class SetupDialogue:
    """The dialogue in a terminal. Its answers so far are always in the file `saved`."""

    def __init__(self, config: Path, saved: Path, before: Settings, arguments: argparse.Namespace) -> None:
        self._config = config
        self._saved = saved
        self._before = before
        self._port: str | None = arguments.port
        self._answers = SetupAnswers()
        if saved.exists() and not arguments.anew:
            self._answers = setup.read_answers(saved, before)
            say(f"Going on with the answers in {saved}; --anew asks all of them again.")

    def hold(self) -> None:
        """Ask all that is open, write the files, start the service."""
        with self._greet() as session:
            _look_at(session)
            names = outputs(session)
            self._take_port(lasting_name(session.path))
            self._check_outputs(session, names)
            report_period_s = session.hello.report_period_s
        self._ask_box()
        for path, text, difference in _files(self._config, self._before, self._answers, report_period_s):
            _put(path, text, difference, lambda: ask("Replace it?", ("yes", "no")) == "yes")
        self._start()
        self._saved.unlink(missing_ok=True)
        _say_next()

    def _take_port(self, port: str) -> None:
        """Save the port; results of another board's outputs are dropped."""
        outputs = self._answers.outputs if port == self._answers.port else {}
        self._save(replace(self._answers, port=port, outputs=outputs))

    def _save(self, answers: SetupAnswers) -> None:
        with writing(self._saved):
            setup.write_answers(self._saved, answers)
        self._answers = answers

    def _greet(self) -> BoardSession:
        """Return a session with the board, after as many tries as the person makes."""
        path = self._port or self._answers.port or _choose_port()
        while True:
            say(f"Greeting the board at {path}. It restarts; this takes up to 15 s.")
            try:
                return BoardSession(path)
            except RequestError as error:
                say(str(error))
            path = ask("Enter: try again; or type another port.") or path

    def _check_outputs(self, session: BoardSession, names: Sequence[str]) -> None:
        for name in names:
            if name not in self._answers.outputs:
                result = _check_output(session, name)
                self._save(replace(self._answers, outputs={**self._answers.outputs, name: result}))

    def _ask_box(self) -> None:
        while (question := next_question(self._answers)) is not None:
            print()
            say(question.text)
            say(f"The paper's box, as an example: {question.example}")
            self._ask_until_taken(question)
            value = getattr(self._answers, question.key)
            say(f"  {question.key}: {f'{value:g}' if isinstance(value, float) else value or 'not known'}")

    def _ask_until_taken(self, question: BoxQuestion) -> None:
        while True:
            try:
                self._save(answer(self._answers, question, input("> "), self._before))
                return
            except RequestError as error:
                say(f"Not taken: {error}")

    def _start(self) -> None:
        _say_no_effect(self._answers)
        if obstacle := setup.start_obstacle():
            _say_commands(obstacle)
        elif ask("Start the service now?", ("yes", "no")) == "yes":
            done = setup.start_service()
            say("The service runs." if done else "It did not start: `journalctl -u greenhouse` says why.")


def _look_at(session: BoardSession) -> None:
    for line in chain(show(session), give_own_id(session)):
        say(line)


def _check_folder(folder: Path) -> None:
    if not folder.is_dir():
        raise RequestError(f"{folder}: is missing; `{setup.INSTALL}` makes /etc/greenhouse")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise RequestError(
            f"{folder}: this user cannot write there; `sudo greenhouse setup`, or name --config"
        )


def _choose_port() -> str:
    """Return the port of the only board, or the one that the person names."""
    while not (ports := find_ports()):
        path = ask("No board is found. Plug it into USB, then Enter; or type its port.")
        if path:
            return path
    if len(ports) == 1:
        say(f"A board may be at {ports[0].path}: {ports[0].text}")
        return ports[0].path
    for number, port in enumerate(ports, 1):
        say(f"{number}  {port.path}: {port.text}")
    numbers = [str(number) for number in range(1, len(ports) + 1)]
    return ports[int(ask("Which one is the board of this box?", numbers)) - 1].path


def _check_output(session: BoardSession, name: str) -> OutputResult:
    """Test one output as often as the person wants. Errors: RequestError for a lost line"""
    check = suited_check(session, name)
    words = ask(f"{check.label}: {check.action}, for at most {check.seconds:g} s. Check it?", ("yes", "skip"))
    while words in ("yes", "again"):
        say("It runs; Ctrl-C turns it off at once.")
        try:
            if run_check(session, check, say):
                say("Its effect is seen.")
                return "works"
            if check.signal:
                say("No effect is seen by the sensor. A heavy box may take longer.")
            words = ask(check.question, ("yes", "no", "again"))
            if words != "again":
                return "works" if words == "yes" else "no effect"
        except OutputRefused as error:
            say(f"Not checked: {error}.")
            words = ask("Try it again?", ("again", "skip"))
        except RequestError as error:
            raise RequestError(f"{error}; the board turns all off by itself within {LEASE_S:g} s") from None
    return "skipped"


def _files(
    config: Path, before: Settings, answers: SetupAnswers, report_period_s: float
) -> list[tuple[Path, str, list[str]]]:
    """Return path, text and difference to what is there, for each file; all are checked.

    The twin file is first, so that edge.yaml never names one that is missing.

    Errors : ConfigError, RequestError, DataError
    """
    twin = config.absolute().with_name("twin.yaml")
    settings = setup.settings_of(before, answers, report_period_s, twin)
    _check(
        config, replace(settings, box=BoxSettings(heater_w=answers.heater_w or 0.0))
    )  # its twin file is not there yet
    if settings.control.controller != before.control.controller:
        say("The packaged models are those of the paper's box: at first the controller `rules` decides.")
    changed = [f"{key}: {old} -> {new}" for key, old, new in changed_keys(settings, before)]
    text = setup.twin_of(answers)
    lines = difflib.unified_diff(
        (setup.text_before(twin) or "").splitlines(), text.splitlines(), "before", "now", lineterm="", n=0
    )
    return [(twin, text, list(lines)), (config, setup.edge_text(settings), changed)]


def _check(config: Path, settings: Settings) -> None:
    """Check as `greenhouse check-config` does. Errors: ConfigError"""
    found = list(problems(settings))
    for problem in found:
        if not problem.is_error:
            say(f"warning: {problem.text}")
    if errors := [problem.text for problem in found if problem.is_error]:
        raise ConfigError("\n".join(f"{config}: {text}" for text in errors))


def _put(path: Path, text: str, difference: list[str], may_replace: Callable[[], bool]) -> None:
    """Write a file, and keep the one before. Errors: RequestError where it may not be replaced, DataError"""
    before = setup.text_before(path)
    if before is not None and not difference:
        say(f"{path}: stays as it is")
        return
    if before is not None:
        print()
        say(f"{path} is there already. The file now differs:")
        print("\n".join(line[:WIDTH] for line in difference))
        say("The old file stays under another name, with its comments.")
        if not may_replace():
            raise RequestError(f"{path}: stays as it is; nothing was written to it")
    with writing(path):
        kept = setup.put(path, text, datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ"))
    say(f"{path}: written" + (f"; before: {kept.name}" if kept else ""))


def _run_unattended(arguments: argparse.Namespace, before: Settings) -> None:
    """Write the files from a file of answers. Errors: ConfigError, DataError, RequestError"""
    source: Path = arguments.from_answers
    answers = setup.read_answers(source, before)
    port = arguments.port or answers.port
    missing = [q.key for q in QUESTIONS if q.applies(answers) and getattr(answers, q.key) is None]
    if missing or not port:
        raise RequestError(f"{source}: missing: {', '.join(missing or ['port'])}")
    with BoardSession(port) as session:
        _look_at(session)
        unchecked = [name for name in outputs(session) if name not in answers.outputs]
        report_period_s = session.hello.report_period_s
    if unchecked:
        say(f"Not checked: {', '.join(unchecked)}; without a person nothing is driven.")
    answers = replace(answers, port=port)
    for path, text, difference in _files(arguments.config, before, answers, report_period_s):
        _put(path, text, difference, lambda: arguments.replace)
    _say_no_effect(answers)
    _say_commands(setup.start_obstacle() or ["to start it:", setup.START])
    _say_next()


def _say_no_effect(answers: SetupAnswers) -> None:
    bad = [CHECKS[name].label for name, result in answers.outputs.items() if result == "no effect"]
    if bad:
        say(f"Mind: no effect was seen of: {', '.join(bad)}. Check relay, supply and wires.")


def _say_commands(obstacle: Sequence[str]) -> None:
    """Print a reason and commands, each on a line that can be copied."""
    reason, *commands = obstacle
    say(f"The service: {reason}")
    print("\n".join(f"  {command}" for command in commands))


def _say_next() -> None:
    print()
    say("Next: `greenhouse watch` shows the daemon; `greenhouse commission` lets it learn your box.")
