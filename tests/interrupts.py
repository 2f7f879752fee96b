"""Children of tests that Ctrl-C reaches."""

import subprocess
import sys
from typing import Any

LISTEN = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
"""First line of a child's program. A shell that runs tests in the background ignores interrupts, and its children
inherit this."""
MAIN = "from lobewise.cli import main; main()"


def start_program(*words: object, program: str = MAIN, **options: Any) -> subprocess.Popen[str]:
    """Start lobewise, or another program, with some words. What it prints can be read unless ``options`` say where."""
    command = [sys.executable, "-c", LISTEN + program, *map(str, words)]
    return subprocess.Popen(command, **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, **options})
