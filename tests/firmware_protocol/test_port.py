"""virtual_board/port.py: a host that opens the device again finds it alive, however soon it comes."""

import os

import pytest

from firmware_protocol.virtual_board import port as port_module
from firmware_protocol.virtual_board.port import PseudoTerminal


@pytest.fixture
def port(tmp_path):
    terminal = PseudoTerminal(tmp_path / "port")
    terminal.plug()
    yield terminal
    terminal.unplug()


def opened(port):
    return os.open(port.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)


def test_a_host_that_opens_later_gets_a_new_device(port, tmp_path):
    host, first = opened(port), port.device
    os.write(host, b"hello")
    assert port.read() == b"hello"
    port.user = self = object()
    os.close(host)
    assert port.read() == b"" and port.user is not self
    assert port.device != first and str((tmp_path / "port").readlink()) == port.device


def test_a_host_that_opens_while_a_new_device_is_made_keeps_the_old_one(port, tmp_path, monkeypatch):
    host, first = opened(port), port.device
    os.write(host, b"stale")
    os.close(host)
    hosts = []
    make = port_module._open_pseudo_terminal

    def opened_meanwhile():
        hosts.append(opened(port))
        return make()

    monkeypatch.setattr(port_module, "_open_pseudo_terminal", opened_meanwhile)
    port.read()
    assert port.device == first and str((tmp_path / "port").readlink()) == first and port.user is None
    os.write(hosts[0], b"hello")
    assert port.read() == b"hello"
    port.user = port
    port.write(b"answer")
    assert os.read(hosts[0], 100) == b"answer"
    os.close(hosts[0])
