"""The private keys of a farm on this machine are on disk for a moment alone, where no other user can read them."""

from __future__ import annotations

import os
import ssl
from pathlib import Path
from typing import Any

import pytest


@pytest.mark.usefixtures("dask")
@pytest.mark.skipif(os.name != "posix", reason="modes of POSIX")
def test_no_other_user_can_read_the_private_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from distributed.security import Security

    load, places = ssl.SSLContext.load_cert_chain, []

    def watch(context: ssl.SSLContext, certificate: str, key: str, *more: Any) -> None:
        places.append(Path(key))
        assert Path(key).parent.stat().st_mode & 0o077 == 0
        load(context, certificate, key, *more)

    monkeypatch.setattr(ssl.SSLContext, "load_cert_chain", watch)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    security = Security.temporary()
    for role in ("scheduler", "worker"):
        security.get_listen_args(role)
    security.get_connection_args("client")
    assert len(places) == 3
    assert all(tmp_path in place.parents for place in places)
    assert list(tmp_path.iterdir()) == []
