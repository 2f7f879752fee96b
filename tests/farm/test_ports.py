"""The ports of a farm on this machine refuse strangers: other users of the machine, and web pages."""

from __future__ import annotations

import os
import socket
import ssl
import sys
import threading
from pathlib import Path

import pytest

from lobewise.farm.connection import start_local
from tests.farm.processes import wait_until

LISTENING = "0A"
"""State of a socket in ``/proc/net/tcp``."""


def list_processes() -> set[int]:
    """Return this process and all below it."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
    found, added = set(), {os.getpid()}
    while added:
        found |= added
        added = {number for number, parent in parents.items() if parent in found} - found
    return found


def list_ports() -> set[int]:
    """Return the TCP ports at which this process and all below it listen."""
    sockets = set()
    for number in list_processes():
        for name in Path(f"/proc/{number}/fd").glob("*"):
            try:
                sockets.add(os.readlink(name))
            except OSError:
                continue
    lines = [
        line.split() for kind in ("tcp", "tcp6") for line in Path(f"/proc/net/{kind}").read_text().splitlines()[1:]
    ]
    mine = [words for words in lines if words[3] == LISTENING and f"socket:[{words[9]}]" in sockets]
    assert all(words[1].startswith("0100007F:") for words in mine), "a port is open to other machines"
    return {int(words[1].rpartition(":")[2], 16) for words in mine}


def ask(port: int, context: ssl.SSLContext | None) -> bytes:
    """Return the answer of a port to a request for a page, by TLS where there is a context; empty if it refuses."""
    try:
        stream = socket.create_connection(("127.0.0.1", port), 5.0)
        with stream if context is None else context.wrap_socket(stream) as stream:
            stream.sendall(b"GET /health HTTP/1.0\r\n\r\n")
            return stream.recv(100)
    except (ssl.SSLError, ConnectionError):
        return b""


@pytest.mark.usefixtures("dask")
@pytest.mark.skipif(sys.platform != "linux", reason="the ports of a process are read from /proc")
def test_every_port_of_local_workers_refuses_strangers() -> None:
    from distributed.security import Security

    nobody = ssl.create_default_context()
    nobody.check_hostname, nobody.verify_mode = False, ssl.CERT_NONE
    stranger = Security.temporary().get_connection_args("client")["ssl_context"]
    stranger.check_hostname, stranger.verify_mode = False, ssl.CERT_NONE
    before = list_ports()
    # While it starts, Dask has servers that answer HTTP; they have no page, and the start ends with them.
    answers: set[bytes] = set()
    started = threading.Event()

    def ask_until_started() -> None:
        while not started.is_set():
            answers.update(ask(port, None) for port in list_ports() - before)

    asking = threading.Thread(target=ask_until_started)
    asking.start()
    with start_local(2, memory_bytes=2 << 30) as connection:
        wait_until(lambda: len(connection.list_workers()) == 2)
        started.set()
        asking.join()
        assert all(answer == b"" or answer.startswith(b"HTTP/1.1 404") for answer in answers), answers
        ports = list_ports() - before
        # The scheduler, two workers and Dask's two processes that watch them.
        assert len(ports) == 5
        for port in ports:
            for context in (None, nobody, stranger):
                assert ask(port, context) == b""
        assert len(connection.list_workers()) == 2
    assert list_ports() == before
