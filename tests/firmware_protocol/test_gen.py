"""The generator: its files are in step with messages.yaml, C agrees with Python, a bad source is refused."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol import gen, gen_spec
from firmware_protocol.gen_spec import MessageSpec, read_spec
from firmware_protocol.messages import CLASS_OF_KIND, LAYOUT_OF_KIND

pytestmark = pytest.mark.slow

SPEC = read_spec()
WITH_FIELDS = [message for message in SPEC.messages if message.fields]
C_TYPES = {"u8": ctypes.c_uint8, "u16": ctypes.c_uint16, "u32": ctypes.c_uint32, "u64": ctypes.c_uint64,
           "i16": ctypes.c_int16}  # fmt: skip
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")


def structure(message: MessageSpec) -> type[ctypes.Structure]:
    fields = [(field.name, C_TYPES[field.wire]) for field in message.fields]
    return type(message.name, (ctypes.Structure,), {"_fields_": fields})


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The static functions of the header behind exported names."""
    folder = tmp_path_factory.mktemp("gen")
    lines = ['#include "gh_messages.h"']
    for message in WITH_FIELDS:
        name = message.name
        lines += [
            f"size_t pack_{name}(const gh_{name} *m, uint8_t *out) {{ return gh_pack_{name}(m, out); }}",
            f"int unpack_{name}(const uint8_t *b, size_t n, gh_{name} *m)",
            f"{{ return gh_unpack_{name}(b, n, m); }}",
        ]
    (folder / "gen.c").write_text("\n".join(lines) + "\n")
    flags = ["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-shared", "-fPIC"]
    files = ["-I", gen.HERE / "c", folder / "gen.c", "-o", folder / "gen.so"]
    subprocess.run(["gcc", *flags, *files], check=True)
    return ctypes.CDLL(str(folder / "gen.so"))


@pytest.mark.parametrize("path", sorted(gen.outputs(SPEC)), ids=lambda path: path.name)
def test_the_generated_file_is_what_messages_yaml_says(path: Path) -> None:
    assert path.read_text(encoding="utf-8") == gen.outputs(SPEC)[path], "run python -m firmware_protocol.gen"


def test_python_has_every_message_of_the_source() -> None:
    for message in SPEC.messages:
        assert CLASS_OF_KIND[message.kind].__name__ == message.class_name
        assert LAYOUT_OF_KIND[message.kind].struct.size == message.length
    assert len(CLASS_OF_KIND) == len(SPEC.messages)


@needs_gcc
@pytest.mark.parametrize("message", WITH_FIELDS, ids=lambda message: message.name)
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_c_reads_and_writes_the_same_bytes_as_python(
    library: ctypes.CDLL, message: MessageSpec, data: st.DataObject
) -> None:
    layout = LAYOUT_OF_KIND[message.kind]
    near_edges = [
        st.sampled_from([f.low, f.high, *([] if f.none is None else [f.none])]) | st.integers(f.low, f.high)
        for f in message.fields
    ]
    raws = tuple(data.draw(near) for near in near_edges)
    body = layout.struct.pack(*raws)
    received = structure(message)()
    assert getattr(library, f"unpack_{message.name}")(body, len(body), ctypes.byref(received)) == 0
    assert tuple(getattr(received, f.name) for f in message.fields) == raws
    out = ctypes.create_string_buffer(len(body) + 1)
    assert getattr(library, f"pack_{message.name}")(ctypes.byref(received), out) == len(body)
    assert out.raw == body + b"\0"


@needs_gcc
@pytest.mark.parametrize("message", WITH_FIELDS, ids=lambda message: message.name)
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_c_refuses_the_same_bodies_as_python(
    library: ctypes.CDLL, message: MessageSpec, data: st.DataObject
) -> None:
    layout = LAYOUT_OF_KIND[message.kind]
    body = data.draw(st.binary(min_size=message.length, max_size=message.length))
    refused = layout.first_refused(layout.struct.unpack(body))
    code = getattr(library, f"unpack_{message.name}")(body, len(body), ctypes.byref(structure(message)()))
    assert code == (0 if refused is None else refused << 8 | 4)  # GH_ERROR_CODE_RANGE


@needs_gcc
@pytest.mark.parametrize("message", WITH_FIELDS, ids=lambda message: message.name)
@pytest.mark.parametrize("change", [-1, 1, 300])
def test_c_refuses_a_wrong_length(library: ctypes.CDLL, message: MessageSpec, change: int) -> None:
    length = message.length + change
    code = getattr(library, f"unpack_{message.name}")(bytes(400), length, ctypes.byref(structure(message)()))
    assert code == min(length, 255) << 8 | 3  # GH_ERROR_CODE_LENGTH


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        pytest.param("external: 1", "external: 7", "enums.reset_cause", id="a gap in an enum"),
        pytest.param("id: 7", "id: 6", "same id", id="two messages of one id"),
        pytest.param(
            '  trip_cause: "', '  trips: "', "docs: missing key 'trip_cause'", id="an enum without a text"
        ),
        pytest.param("max_body: 48", "max_body: 34", "messages.hello", id="a body too long"),
    ],
)
def test_a_bad_source_is_refused_with_its_place(tmp_path: Path, old: str, new: str, place: str) -> None:
    source = tmp_path / "messages.yaml"
    text = gen_spec.SOURCE.read_text(encoding="utf-8")
    assert old in text
    source.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ValueError, match=place):
        read_spec(source)
