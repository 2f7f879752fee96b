"""The options of a farm: several processes, or several machines, filter the frames of a sequence."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from lobewise.cli.options.common import require_pattern
from lobewise.cli.terminal.help import sequence_detail, sequence_option
from lobewise.errors import InputError
from lobewise.work.limits import GIB, get_limits, measure_machine_memory

if TYPE_CHECKING:
    from lobewise.farm.calls import Connection

MAX_WORKERS = 1024


@dataclass(frozen=True)
class Farm:
    """Options that tell which processes filter the frames of a sequence."""

    farm: Annotated[
        str | None,
        sequence_detail(
            "--farm",
            metavar="ADDRESS",
            help="Send the frames of a sequence to the workers of a Dask scheduler, such as tls://host:8786. Every "
            "machine must see the files by the same paths.",
            show_default=False,
        ),
    ] = None
    insecure: Annotated[
        bool,
        sequence_detail(
            "--insecure",
            help="With --farm: allow another machine's scheduler without TLS. Whoever reaches that network can run "
            "programs here.",
        ),
    ] = False
    workers: Annotated[
        int | None,
        sequence_option("--workers", metavar="N", help="Filter N frames at once, in N processes.", show_default=False),
    ] = None

    @property
    def is_wanted(self) -> bool:
        """Whether a farm is asked for."""
        return self.farm is not None or self.workers is not None

    def check(self, source: Path) -> None:
        """Raise InputError if an option is wrong, or the options do not go together."""
        if not self.is_wanted:
            return
        if self.workers is not None and not 1 <= self.workers <= MAX_WORKERS:
            raise InputError(
                "--workers",
                expected=f"a number from 1 to {MAX_WORKERS}",
                got=str(self.workers),
                action="try the number of cores divided by 4",
            )
        require_pattern("--workers" if self.farm is None else "--farm", source)
        if self.farm is not None and not self.insecure:
            from lobewise.farm.connection import require_secure

            require_secure(self.farm)

    @property
    def memory(self) -> float | None:
        """GiB that a worker may take: a given limit, else a part of this machine; None for its own limit."""
        limit = get_limits().memory
        if limit is not None or self.workers is None:
            return limit
        there = measure_machine_memory()
        return None if there is None else there / GIB / self.workers

    def open(self) -> AbstractContextManager[Connection]:
        """Return the connection to the workers; see `lobewise.farm` for the errors."""
        if self.farm is None:
            from lobewise.farm.processes import start_local

            assert self.workers is not None
            return start_local(self.workers)
        from lobewise.farm.connection import connect, require_distributed

        require_distributed()
        return connect(self.farm)
