"""Command lines that must fail."""

import importlib
from typing import Any

import pytest

from lobewise.errors import LobewiseError
from tests.mistakes import check_fields


def fail(capsys: pytest.CaptureFixture[str], *words: object, **fields: str) -> LobewiseError:
    """Run a line that must fail with an error of these fields, which is all that it prints; return the error."""
    main = importlib.import_module("lobewise.cli.program")
    told: list[Any] = []
    tell = main._fail
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(main, "_fail", lambda problem, *rest: (told.append(problem), tell(problem, *rest))[1])
        capsys.readouterr()
        assert main.run([str(word) for word in words]) == 2
    (problem,) = told
    assert capsys.readouterr() == ("", f"lobewise: {problem}\n")
    check_fields(problem, **fields)
    return problem
