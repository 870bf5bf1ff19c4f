"""The C board builds clean, keeps no state of its own, and fits a small board."""

import re
import shutil
import subprocess

import pytest

from tests.support.c_core import SOURCES, CompilerMissing, compile_board

DRIVERS = SOURCES / "drivers"
CORE_FILES = sorted(SOURCES.glob("gh_*.c"))
DRIVER_FILES = sorted(DRIVERS.glob("gh_*.c"))
C_FILES = CORE_FILES + DRIVER_FILES
ALL_FILES = C_FILES + sorted(SOURCES.glob("gh_*.h")) + sorted(DRIVERS.glob("gh_*.h"))
INCLUDES = ["-I", str(SOURCES), "-I", str(DRIVERS)]
STRICT = ["-std=c11", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-pedantic"]
ALLOWED_HEADERS = {"stdint.h", "stddef.h", "string.h", "stdbool.h"}
ALLOWED_CALLS = {"memcpy", "memmove", "memset", "memcmp"}


def tool(name: str) -> str:
    """A program of the build. A missing one fails the test: a build that nobody tried may not work."""
    if shutil.which(name) is None:
        pytest.fail(f"{name} is missing: `make test` installs gcc, gcc-avr and avr-libc")
    return name


def name_of(path) -> str:
    return path.name


def code_of(path) -> str:
    """A source without comments and strings."""
    return re.sub(r'/\*.*?\*/|//[^\n]*|"[^"\n]*"', " ", path.read_text(encoding="utf-8"), flags=re.DOTALL)


@pytest.mark.parametrize("path", C_FILES, ids=name_of)
@pytest.mark.parametrize("optimise", ["-O0", "-O2", "-Os"])
def test_every_source_compiles_without_a_warning(path, optimise, tmp_path):
    flags = [*STRICT, optimise, *INCLUDES]
    subprocess.run([tool("gcc"), *flags, "-c", str(path), "-o", str(tmp_path / "x.o")], check=True)


@pytest.mark.parametrize("path", DRIVER_FILES, ids=name_of)
def test_every_driver_compiles_for_a_small_avr_and_is_as_small_as_its_header_tells(path, tmp_path):
    header = path.with_suffix(".h")
    sizes = re.findall(r"sizeof\((\w+)\) is (\d+) on an AVR", header.read_text(encoding="utf-8"))
    source = tmp_path / "x.c"
    asserts = [f'_Static_assert(sizeof({name}) == {size}, "{name}");' for name, size in sizes]
    source.write_text("\n".join([f'#include "{path}"', *asserts, ""]), encoding="utf-8")
    flags = ["-mmcu=atmega328p", *STRICT, "-Os", *INCLUDES]
    subprocess.run([tool("avr-gcc"), *flags, "-c", str(source), "-o", str(tmp_path / "x.o")], check=True)


def test_it_compiles_with_the_sanitizers(tmp_path):
    tool("gcc")
    main = tmp_path / "main.c"
    main.write_text('#include "gh_board.h"\nint main(void) { return gh_board_size() == 0; }\n')
    flags = [*STRICT, "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    subprocess.run([str(compile_board(tmp_path / "main", str(main), *flags))], check=True)


@pytest.mark.parametrize("path", ALL_FILES, ids=name_of)
def test_nothing_but_the_freestanding_headers_and_string_h_is_included(path):
    text = path.read_text(encoding="utf-8")
    assert set(re.findall(r"#include <(.+?)>", text)) <= ALLOWED_HEADERS
    ours = {header.name for folder in {SOURCES, path.parent} for header in folder.glob("*.h")}
    assert set(re.findall(r'#include "(.+?)"', text)) <= ours  # the core knows no driver


@pytest.mark.parametrize("path", ALL_FILES, ids=name_of)
def test_there_is_no_floating_point(path):
    assert not re.search(r"\b(float|double)\b|\d\.\d|\.\df?\b", code_of(path))


@pytest.mark.parametrize("path", C_FILES, ids=name_of)
def test_there_is_no_state_outside_the_board_and_no_call_outside_string_h(path, tmp_path):
    target = tmp_path / "x.o"
    flags = ["-std=c11", "-O1", *INCLUDES]
    subprocess.run([tool("gcc"), *flags, "-c", str(path), "-o", str(target)], check=True)
    symbols = subprocess.run([tool("nm"), str(target)], check=True, capture_output=True, text=True).stdout
    kinds = [(line.split()[-2], line.split()[-1]) for line in symbols.splitlines()]
    assert [name for kind, name in kinds if kind in "bBdDcC"] == []
    outside = {name for kind, name in kinds if kind == "U" and not name.startswith("gh_")}
    assert outside <= ALLOWED_CALLS


def test_a_missing_compiler_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(CompilerMissing, match=r"no-such-compiler.*install gcc"):
        compile_board(tmp_path / "board.so", "-shared")
