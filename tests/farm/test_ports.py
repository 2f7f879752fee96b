"""The processes of ``--workers`` cannot be reached: by other users of the machine, and by web pages."""

import os
import signal
import sys
from pathlib import Path

import pytest

from lobewise.farm.processes import start_local
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


@pytest.mark.skipif(sys.platform != "linux", reason="the ports of a process are read from /proc")
def test_local_workers_listen_at_no_port() -> None:
    before = list_ports()
    seen: set[int] = set()
    with start_local(2) as workers:
        calls = [workers.call(name, os.getpid) for name in workers.list_workers()]
        while not all(call.has_ended for call in calls):
            seen |= list_ports()
        assert len({call.fetch() for call in calls} & list_processes()) == 2
        assert seen | list_ports() == before
        # A terminal sends Ctrl-C to them as well.
        (name, _) = workers.list_workers()
        call = workers.call(name, signal.pthread_sigmask, signal.SIG_BLOCK, [])
        wait_until(lambda: call.has_ended)
        assert signal.SIGINT in call.fetch()
    assert list_processes().isdisjoint({call.fetch() for call in calls})
