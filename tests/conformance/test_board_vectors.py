"""The golden vectors: what each board answers, what C decodes, packs and unpacks."""

import ctypes
import json
import subprocess
from pathlib import Path

import pytest
from board_bench import CONFIGURABLE, BoardBench, is_error
from board_kinds import SANITIZERS, STRICT

import firmware_protocol
from firmware_protocol.frame import encode
from firmware_protocol.messages import PROTOCOL_VERSION, BlockPart, ErrorCode, Hello, StateEcho, WirePart
from tests.support.c_core import compile_board, load_board

VECTORS = json.loads((Path(firmware_protocol.__file__).parent / "vectors.json").read_text(encoding="utf-8"))
FROM_BOARD = {2, 3, 5, 8, 16, 18, 19}
MESSAGE_NAME = {
    1: "hello_request",
    2: "hello",
    3: "sensor_report",
    4: "command",
    5: "state_echo",
    8: "error",
    13: "block_read",
    14: "block_write",
    16: "block_part",
    17: "wire_search",
    18: "wire_part",
    19: "air_pair",
}
BLOCK_READ, BLOCK_WRITE, BLOCK_COMMIT, WIRE_SEARCH = 13, 14, 15, 17
COUNTERS = ("too_long", "bad_cobs", "too_short", "bad_crc")


def by_name(vectors):
    return pytest.mark.parametrize("vector", vectors, ids=lambda vector: vector["name"])


class Decoder(ctypes.Structure):
    """gh_frame_decoder"""

    _fields_ = (
        ("bytes", ctypes.c_uint8 * 55),
        ("length", ctypes.c_uint8),
        ("overlong", ctypes.c_bool),
        *((name, ctypes.c_uint16) for name in COUNTERS),
    )


@by_name(VECTORS)
def test_the_board_answers_what_the_vector_says(new_board, vector):
    said = BoardBench(new_board, CONFIGURABLE).greet().receive(bytes.fromhex(vector["hex"]))
    payloads = [bytes.fromhex(payload) for payload in vector["payloads"]]
    asked = [p for p in payloads if p[0] != PROTOCOL_VERSION or (p[1] not in FROM_BOARD and p[2] != 0)]
    assert [header.ack for header, _ in said] == [payload[2] for payload in asked]
    if not asked:
        return
    if "error" in vector:
        assert is_error(said[0][1], vector["error"]["code_number"], vector["error"]["detail"])
    elif asked[0][1] in (BLOCK_READ, BLOCK_WRITE):
        assert isinstance(said[0][1], BlockPart)
    elif asked[0][1] == WIRE_SEARCH:
        assert said[0][1] == WirePart(0x28)
    elif asked[0][1] == BLOCK_COMMIT:
        assert is_error(said[0][1], ErrorCode.BAD_BLOCK, 0)
    elif asked[0][1] == 1:
        assert isinstance(said[0][1], Hello)
    elif "message" in vector and vector["name"] != "command of everything":
        assert isinstance(said[0][1], StateEcho)


@by_name(VECTORS)
def test_c_cuts_the_same_payloads_from_the_line(vector):
    library, decoder = load_board(), Decoder()
    library.gh_frame_push.argtypes = (ctypes.POINTER(Decoder), ctypes.c_uint8)
    library.gh_frame_push.restype = ctypes.c_size_t
    payloads = []
    for byte in bytes.fromhex(vector["hex"]):
        length = library.gh_frame_push(decoder, byte)
        if length:
            payloads.append(bytes(decoder.bytes[:length]).hex())
    assert payloads == vector["payloads"]
    counted = {name: getattr(decoder, name) for name in COUNTERS if getattr(decoder, name)}
    if not payloads:
        assert counted == ({vector["dropped"]: 1} if "dropped" in vector else {})


def framing_of(number: int, vector: dict) -> str:
    """C that frames one payload and returns the vector's number when the line is not Python's."""
    payload = bytes.fromhex(vector["payloads"][0])
    frame = encode(payload)
    return f"""
    {{
        const uint8_t payload[] = {{{", ".join(map(str, payload))}}};
        const uint8_t line[] = {{{", ".join(map(str, frame))}}};
        uint8_t out[GH_MAX_FRAME];
        if (gh_frame_encode(payload, sizeof payload, out) != sizeof line)
            return {number};
        if (memcmp(out, line, sizeof line) != 0)
            return {number};
    }}"""


TOO_LONG = """
    const uint8_t payload[GH_MAX_PAYLOAD + 1] = {1};
    uint8_t out[GH_MAX_FRAME];
    return (int)gh_frame_encode(payload, sizeof payload, out);"""


def check_of(number: int, vector: dict) -> str:
    """C that packs and unpacks one message and returns the vector's number when that goes wrong."""
    name = MESSAGE_NAME[vector["message"]["kind"]]
    fields = ", ".join(f".{field} = {value:d}" for field, value in vector["message"]["fields"].items())
    body = ", ".join(f"{byte}" for byte in bytes.fromhex(vector["payloads"][0])[4:])
    return f"""
    {{
        const uint8_t body[] = {{{body}}};
        const gh_{name} message = {{{fields}}};
        gh_{name} back;
        uint8_t out[GH_MAX_BODY];
        if (gh_pack_{name}(&message, out) != sizeof body || memcmp(out, body, sizeof body) != 0)
            return {number};
        if (gh_unpack_{name}(body, sizeof body, &back) != 0 || gh_pack_{name}(&back, out) != sizeof body)
            return {number};
        if (memcmp(out, body, sizeof body) != 0)
            return {number};
    }}"""


def refusal_of(number: int, vector: dict) -> str:
    """C that unpacks one refused body and returns the vector's number when the refusal is another."""
    payload = bytes.fromhex(vector["payloads"][0])
    name, body = MESSAGE_NAME[payload[1]], ", ".join(f"{byte}" for byte in payload[4:]) or "0"
    expected = f"GH_DECODE_ERROR({vector['error']['code_number']}, {vector['error']['detail']})"
    return f"""
    {{
        const uint8_t body[] = {{{body}}};
        gh_{name} back;
        if (gh_unpack_{name}(body, {len(payload) - 4}, &back) != {expected})
            return {number};
    }}"""


REFUSED = [
    v for v in VECTORS if v.get("error", {}).get("code") in ("length", "range")
    and bytes.fromhex(v["payloads"][0])[1] in MESSAGE_NAME
]  # fmt: skip
CHECKS = {  # C by what it shows, and its vectors
    "it frames every payload as Python does": (framing_of, [v for v in VECTORS if len(v["payloads"]) == 1]),
    "it frames no payload that is too long": (lambda number, vector: TOO_LONG, [{"name": "too long"}]),
    "it packs and unpacks every message": (
        check_of,
        [v for v in VECTORS if v.get("message", {}).get("fields")],
    ),
    "it refuses what the vectors refuse": (refusal_of, REFUSED),
}


@pytest.fixture(scope="module")
def checking_program(tmp_path_factory):
    """A sanitized program whose exit code is the number of the first check that fails, 0 for none."""
    folder = tmp_path_factory.mktemp("checks")
    groups = [
        f"if (argv[1][0] == '{group}') {{{''.join(map(code, range(1, len(vectors) + 1), vectors))}\n}}\n"
        for group, (code, vectors) in enumerate(CHECKS.values())
    ]
    source = folder / "check.c"
    source.write_text(
        '#include <string.h>\n#include "gh_frame.h"\n'
        f"int main(int argc, char **argv)\n{{\n(void)argc;\n{''.join(groups)}\nreturn 0;\n}}\n"
    )
    return compile_board(folder / "check", str(source), *STRICT, *SANITIZERS)


@pytest.mark.parametrize("what", CHECKS)
def test_c_holds_to_the_vectors(checking_program, what):
    _, vectors = CHECKS[what]
    code = subprocess.run([str(checking_program), str(list(CHECKS).index(what))], check=False).returncode
    assert vectors and code == 0, vectors[code - 1]["name"]
