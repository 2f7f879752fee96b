"""A peer that is silent, mad or stopped instead of a scheduler: one sentence, in time, and nothing left behind."""

import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest

from lobewise.errors import LobewiseError
from lobewise.farm import connection
from tests.farm.processes import Farm, start_program
from tests.mistakes import refuses


def answer_strangers(callbacks: socket.socket, answer: bytes) -> None:
    """Send an answer to everyone who connects, and keep the connections open until the callbacks is closed."""
    with ExitStack() as open_ones, suppress(OSError):
        while True:
            stranger = open_ones.enter_context(callbacks.accept()[0])
            stranger.sendall(answer)


@pytest.fixture
def peer(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """Return the address of a peer that is no scheduler, or one that is stopped."""
    if request.param == "stopped":
        with Farm(tmp_path, workers=0) as farm:
            farm.wait_for_scheduler()
            with connection.connect(farm.address):
                pass
            farm.scheduler.send_signal(signal.SIGSTOP)
            yield farm.address
        return
    answers = {
        "silent": b"",
        "mad": bytes(range(255, 0, -1)),
        # A count of parts that no message has.
        "many parts": (1 << 35).to_bytes(8, "little"),
        "deaf": b"",
    }
    with socket.create_server(("127.0.0.1", 0)) as callbacks:
        if request.param != "deaf":
            words = (callbacks, answers[request.param])
            threading.Thread(target=answer_strangers, args=words, daemon=True).start()
        yield f"tcp://127.0.0.1:{callbacks.getsockname()[1]}"
        with suppress(OSError):
            callbacks.shutdown(socket.SHUT_RDWR)


SECONDS = 0.5
"""Time to connect of a test that needs no more."""
PEERS = ["silent", "deaf", "mad", "many parts", "stopped"]


@pytest.mark.sampled("mad", "many parts")
@pytest.mark.usefixtures("dask")
@pytest.mark.parametrize("peer", PEERS, indirect=True)
def test_a_peer_that_is_no_scheduler_ends_the_run_in_time(peer: str, sources: Path, folder: Path) -> None:
    program = start_program(sources, folder, "--farm", peer)
    # A busy machine needs some seconds to start the program.
    _, told = program.communicate(timeout=60.0)
    assert program.returncode == 2
    missing, refusal = told.splitlines()
    assert missing == "Frames 13 to 20 of 1 to 32 are missing."
    refused = f"lobewise: --farm: expected a Dask scheduler at {peer}, got no answer of Dask within 7 s"
    assert refusal.startswith(refused)
    with pytest.raises(ProcessLookupError):
        os.killpg(program.pid, 0)
    assert list(folder.iterdir()) == []


@pytest.mark.usefixtures("dask")
@pytest.mark.parametrize("peer", PEERS, indirect=True)
def test_a_peer_that_is_no_scheduler_leaves_no_thread(peer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "CONNECT_SECONDS", SECONDS)
    connection.require_distributed()
    before = set(threading.enumerate())
    begin = time.monotonic()
    with refuses(LobewiseError, "--farm"), connection.connect(peer):
        pass
    # Without its own deadline the call would end only now.
    assert time.monotonic() - begin < SECONDS + connection.CLOSE_SECONDS
    assert set(threading.enumerate()) <= before
