"""Command lines that must fail."""

import pytest

from lobewise.cli.program import run


def fail(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """Run a line that must fail with the user's exit code; return its one sentence."""
    capsys.readouterr()
    assert run([str(word) for word in words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "Traceback" not in err
    assert err.startswith("lobewise: ")
    assert err.count("\n") == 1
    assert err.rstrip().endswith((".", "?"))
    return err
