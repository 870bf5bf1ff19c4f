"""Work on a board beside the daemon: look at it, configure it, flash it. Each returns lines for a person."""

import secrets
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from edge.board.board_file import BOARDS, EXAMPLE_ID, ID_MAX
from edge.board.board_session import BoardSession, NobodyAnswers
from edge.board.firmware_file import CHIPS, avrdude, firmware_file, write_stages
from edge.board.wiring import wiring_table
from edge.core.errors import RequestError
from edge.core.names import HEATER_LEVELS, SIGNALS
from edge.formats.table import Table
from firmware_protocol.board_block import BoardBlock, decode_block, encode_block
from firmware_protocol.messages import Capability, Hello, SensorReport, StateEcho

LEFT_BEHIND = "The old program runs, or the board is stopped and drives nothing."
SETTLED_S = 0.5  # a port that was closed a moment ago may still hang up on the next who opens it
Write = Callable[..., None]  # avrdude, or a test's own
STAGES = ("the program, with a first page that stops the board", "its own first page")


def show(session: BoardSession) -> Iterator[str]:
    """Yield version, state, wires and present values. Errors: RequestError"""
    yield _about(session.hello)
    state = session.state()
    yield _about_state(state)
    block = session.block()
    yield ""
    yield from _about_block(block)
    # While the heater is driven the board refuses the search.
    parts = [] if block is None or state.heater_steps > 0 else session.wire_parts()
    if parts:
        yield f"on the 1-Wire: {', '.join(map(_rom_name, parts))}"
    yield ""
    yield from _values(session.report()).text()


def _rom_name(rom: int) -> str:
    """Return a ROM code as Linux and board.yaml write it: family, then the serial number."""
    return f"{rom & 0xFF:02x}-{rom >> 8 & (1 << 48) - 1:012x}"


def _about(hello: Hello) -> str:
    cause = hello.reset_cause.name.lower().replace("_", " ")
    program = f"{hello.firmware_major}.{hello.firmware_minor}.{hello.firmware_patch}"
    return f"board {hello.board_id}, program {program}; start {hello.boot_count}, by {cause}"


def _about_state(state: StateEcho) -> str:
    outputs = [f"heater {state.heater_steps / HEATER_LEVELS:.2f}"]
    if state.heater_steps == 0:
        outputs[0] += f" ({state.heater_off_cause.name.lower().replace('_', ' ')})"
    outputs += [f"fan {'on' if state.fan_on else 'off'}", f"LED {state.led_pct} %"]
    if state.tripped:
        outputs.append(f"TRIPPED: {state.trip_cause.name.lower().replace('_', ' ')}")
    return ", ".join(outputs)


def _about_block(block: bytes | None) -> Iterator[str]:
    if block is None:
        yield "its program takes no configuration: pins and sensors are compiled into it"
        return
    try:
        yield from wiring_table(decode_block(block), with_notes=False).text()
    except ValueError as error:
        yield f"no configuration: {error}. The board drives no pin."
        yield "`greenhouse board configure FILE` writes one."


def configuration(session: BoardSession) -> BoardBlock:
    """Return the configuration in force. Errors: RequestError where there is none"""
    block = session.block()
    try:
        if block is None:
            raise ValueError("its program takes none")
        return decode_block(block)
    except ValueError as error:
        raise RequestError(f"the board has no configuration: {error}") from None


def _values(report: SensorReport) -> Table:
    rows = []
    for name, signal in SIGNALS.items():
        value, quality = getattr(report, signal.key), getattr(report, f"{name}_quality")
        shown = "-" if value is None else f"{value:.4g}"
        rows.append((signal.label, shown, signal.unit, quality.name.lower()))
    return Table("present values", ("signal", "value", "unit", "quality"), tuple(rows))


def configure(session: BoardSession, block: BoardBlock) -> Iterator[str]:
    """Write a configuration and check it. Errors: RequestError; then the old one is in force"""
    before = session.block()
    if before is None:
        raise RequestError(
            "the board's program takes no configuration; `greenhouse board flash` writes one that does"
        )
    if block.board_id == EXAMPLE_ID:
        block = replace(block, board_id=session.hello.board_id or _new_id())
    wanted = encode_block(block)
    if before == wanted:
        yield "the board has this configuration already; nothing was written"
        return
    session.write_block(wanted)
    yield f"configured: {_about(session.hello)}"
    yield from wiring_table(block, with_notes=False).text()


def give_own_id(session: BoardSession) -> Iterator[str]:
    """Draw an id for a board that has the example's. Errors: RequestError; then the board has the old one"""
    if session.hello.board_id == EXAMPLE_ID and session.hello.capabilities & Capability.CONFIGURABLE:
        session.write_block(encode_block(replace(configuration(session), board_id=_new_id())))
        yield f"The board's id is {session.hello.board_id} now; a daemon that drove it needs `board accept`."


def _new_id() -> int:
    return EXAMPLE_ID + 1 + secrets.randbelow(ID_MAX - EXAMPLE_ID)


def flash(board: str, port: str, baudrate: int, write: Write = avrdude) -> Iterator[str]:
    """Flash the package's program; yield what is before, what is done, what is after.

    Errors: RequestError. Where a stage failed it says in what state the board is.
    """
    kind, file = BOARDS[board], firmware_file(board)
    before = None
    try:
        with BoardSession(port) as session:
            if session.state().heater_steps > 0:
                raise RequestError(f"{port}: the heater is driven; its lease ends within a minute")
            before = session.block()
            yield f"before: {_about(session.hello)}"
    except NobodyAnswers as error:  # as a new board does
        yield f"before: {error}"
    with tempfile.TemporaryDirectory(prefix="greenhouse-flash-") as name:
        stages = write_stages(file.path.read_text(), CHIPS[kind].page, Path(name))
        for number, (stage, path) in enumerate(zip(STAGES, stages, strict=True), 1):
            yield f"writing {number} of {len(STAGES)}: {stage}"
            try:
                write(kind, port, path, baudrate)
                time.sleep(SETTLED_S)
            except RequestError as error:
                said = f"{error}. {LEFT_BEHIND} Run the same command again."
                raise RequestError(said) from None
    yield from _after(port, file.version, before)


def _after(port: str, version: tuple[int, int, int], before: bytes | None) -> Iterator[str]:
    with BoardSession(port) as session:
        hello = session.hello
        yield f"after: {_about(hello)}"
        if (hello.firmware_major, hello.firmware_minor, hello.firmware_patch) != version:
            raise RequestError(f"{port}: the program that answers is not the one that was written")
        if before is not None and session.block() != before:
            raise RequestError(
                f"{port}: the configuration has changed; check it with `greenhouse board show`"
            )
        yield "the configuration is the same" if before is not None else "it has no configuration yet"
