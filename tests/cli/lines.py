"""Command lines that must fail."""

import pytest

from lobewise.errors import LobewiseError
from tests.mistakes import refuse_command


def fail(capsys: pytest.CaptureFixture[str], *words: object, **fields: str) -> LobewiseError:
    """Run a line that must fail with an error of these fields, which is all that it prints; return the error."""
    return refuse_command(capsys, words, **fields)
