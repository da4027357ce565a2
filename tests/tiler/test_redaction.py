"""Text for terminals, logs and files, without secrets."""

from __future__ import annotations

import pytest

from tiler.core.records import digest_of
from tiler.errors import ConfigError, CorruptStoreError, InputError
from tiler.io.locations import as_path, location
from tiler.redaction import printable, shown, stored, without_secrets
from tiler.store.storage import Storage


@pytest.mark.parametrize(
    ("text", "rest"),
    [
        (
            "https://anna:pw@host:80/town.laz?token=t: cannot be read",
            "https://host:80/town.laz: cannot be read",
        ),
        ("https://TOKEN@host/x", "https://host/x"),
        (
            "two: http://a:b@c/x?y, and (ftp://d:e@f/z?w=1).",
            "two: http://c/x, and (ftp://f/z).",
        ),
        ("URL('https://host/x?sig=abc')", "URL('https://host/x')"),
        ("https://host/my town.laz?sig=abc", "https://host/my town.laz"),
        ("https:/anna:pw@host/x", "https:/host/x"),
        ("simplecache::ftp://anna:pw@host/x", "simplecache::ftp://host/x"),
        ("ftp://anna:p/w@host/x", "ftp://host/x"),
        ("ftp://anna:p#w?@host/x", "ftp://host/x"),
        ('"http://h/x?a=b\\"c', '"http://h/x\\"c'),
        (
            "headers=<D('Authorization': 'Basic YTpi', 'A': 'b')>",
            "headers=<D('Authorization': ..., 'A': 'b')>",
        ),
        ("authorization: Bearer abc.def-g_h\nHost: h", "authorization: ...\nHost: h"),
        # Text that is no secret stays.
        ("s3://bucket/a@b.laz: gone", "s3://bucket/a@b.laz: gone"),
        ("http://[::1]:80/x@y", "http://[::1]:80/x@y"),
        (
            "abfs://container@account.dfs.core.windows.net/x",
            "abfs://container@account.dfs.core.windows.net/x",
        ),
        ("s3://b/k: is that so? yes", "s3://b/k: is that so? yes"),
        ("a?b@c d.laz", "a?b@c d.laz"),
    ],
)
def test_urls_lose_user_password_and_query(text: str, rest: str) -> None:
    assert without_secrets(text) == rest
    assert without_secrets(rest) == rest


def test_values_are_stripped_whole() -> None:
    value = {
        "http://a:b@c/x?t": ["http://a:b@c/y", {"n": 1.5, "none": None, "text": "a\nb"}],
        "pair": ("s", 2),
    }
    assert stored(value) == {
        "http://c/x": ["http://c/y", {"n": 1.5, "none": None, "text": "a\nb"}],
        "pair": ["s", 2],
    }


def test_characters_that_are_not_printable_become_escapes() -> None:
    assert (
        printable("a\nb \x1b[2J gr\udcfcn gr\u00fcn \u202e")
        == "a\\nb \\x1b[2J gr\\udcfcn gr\u00fcn \\u202e"
    )
    assert shown("\x9b1m http://a:b@c") == "\\x9b1m http://c"


def test_an_error_never_holds_a_secret() -> None:
    assert str(InputError("http://a:b@c/x?t=1: gone")) == "http://c/x: gone"
    damaged = CorruptStoreError("http://a:b@c/store: k: damaged", ("k",))
    assert (str(damaged), damaged.keys) == ("http://c/store: k: damaged", ("k",))


def test_another_token_does_not_change_the_digest() -> None:
    assert digest_of(["http://a:b@c/x?t=1"]) == digest_of(["http://a:z@c/x?t=2"])
    assert digest_of(["http://c/x"]) != digest_of(["http://c/y"])


def test_the_path_of_a_url_keeps_its_secrets() -> None:
    pytest.importorskip("upath")
    url = "http://anna:pw@host/town.laz?token=t"
    assert location(as_path(url)) == url


def test_a_password_that_breaks_its_url_is_refused() -> None:
    for refuses in (as_path, Storage):
        with pytest.raises(ConfigError, match="use %2F for /") as caught:
            refuses("ftp://anna:pw/x@host/town.laz")
        assert "pw" not in str(caught.value)
