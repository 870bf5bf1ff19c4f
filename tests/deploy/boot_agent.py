"""Runs in the booted machine as root: a shell command by line of JSON, its exit code and output by line."""

import json
import subprocess
import time
from pathlib import Path

PORTS = Path("/sys/class/virtio-ports")


def port() -> Path:
    """Wait for the port that is named agent."""
    while True:
        for name in PORTS.glob("*/name"):
            if name.read_text().strip() == "agent":
                return Path("/dev") / name.parent.name
        time.sleep(1.0)


with port().open("r+b", buffering=0) as line_port:
    while True:
        line = line_port.readline()
        if not line.endswith(b"\n"):  # the host has not opened its end
            time.sleep(0.2)
            continue
        asked = json.loads(line)
        done = subprocess.run(asked["sh"], shell=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        answer = {"id": asked["id"], "code": done.returncode, "out": done.stdout.decode(errors="replace")}
        rest = json.dumps(answer).encode() + b"\n"
        while rest:
            rest = rest[line_port.write(rest) :]
