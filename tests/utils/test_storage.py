"""Files on disk: atomic writes, limits, typed JSON, arrays with a header."""

import errno
import json
import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file

from autonerf_lab.errors import DataError
from autonerf_lab.utils import storage
from autonerf_lab.utils.storage import (
    check_file,
    interrupted_writes,
    is_disk_full,
    parse_json,
    read_arrays,
    read_bytes,
    read_json,
    write_arrays,
    write_bytes,
    write_json,
)


def test_a_reader_keeps_the_old_file_while_a_new_one_takes_its_place(tmp_path: Path) -> None:
    """A file that is written in place would change, or be half written, under an open reader."""
    path = tmp_path / "two/folders/scores.json"
    write_bytes(path, b"old content")
    with path.open("rb") as reader:
        write_bytes(path, b"new")
        assert reader.read() == b"old content"
    assert path.read_bytes() == b"new" and [p.name for p in path.parent.iterdir()] == ["scores.json"]
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


@pytest.mark.parametrize("step", ["write", "fsync", "replace"])
def test_a_write_that_fails_leaves_the_old_file_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    path = tmp_path / "scores.json"
    write_bytes(path, b"old")

    def full(*arguments: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    class Full:
        def __enter__(self) -> "Full":
            return self

        def __exit__(self, *error: object) -> None:
            os.close(self.handle)

        write = full

    def opened(handle: int, mode: str) -> Full:
        file = Full()
        file.handle = handle
        return file

    if step == "write":
        monkeypatch.setattr(storage.os, "fdopen", opened)
    else:
        monkeypatch.setattr(storage.os, step, full)
    with pytest.raises(DataError, match=r"cannot write .*scores\.json: No space left on device; free some") as raised:
        write_bytes(path, b"new")
    assert is_disk_full(raised.value) and path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]


def test_content_is_on_the_disk_before_it_gets_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    for name in ("fsync", "replace"):
        real = getattr(os, name)
        monkeypatch.setattr(storage.os, name, lambda *a, name=name, real=real: calls.append(name) or real(*a))
    write_bytes(tmp_path / "a", b"x")
    assert calls == ["fsync", "replace"]


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match=r"cannot write .*file/a"):
        write_bytes(tmp_path / "file/a", b"x")


def test_interrupted_writes_are_files_with_names_of_temporary_files(tmp_path: Path) -> None:
    for name in (".a.json.abcd_123", ".a.json.abc", ".a.json.ABCDEFGH", "a.json.abcdefgh", ".lock"):
        (tmp_path / name).touch()
    (tmp_path / ".b.json.abcdefgh").mkdir()
    (tmp_path / ".c.json.abcdefgh").symlink_to(tmp_path / ".lock")
    assert [path.name for path in interrupted_writes(tmp_path)] == [".a.json.abcd_123"]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_a_full_disk_is_recognised_behind_other_errors(number: int) -> None:
    full = OSError(number, "full")
    assert is_disk_full(full)
    try:
        raise DataError("x") from full
    except DataError as error:
        assert is_disk_full(error)
    try:
        try:
            raise full
        except OSError:
            raise ValueError("x")  # noqa: B904
    except ValueError as error:
        assert is_disk_full(error), "an error while handling it"
    assert not is_disk_full(OSError(errno.EACCES, "no permission")) and not is_disk_full(None)


def test_json_is_standard_and_readable(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_json(path, {"a": [1, 2.5, None], "b": "x"})
    assert read_json(path, dict[str, Any]) == {"a": [1, 2.5, None], "b": "x"}
    text = path.read_text()
    assert text.endswith("}\n") and '\n "a": [\n' in text
    for bad in (float("nan"), {1, 2}):
        with pytest.raises(DataError, match=r"cannot write .*a\.json"):
            write_json(path, [bad])
    assert path.read_text() == text


@dataclass
class Point:
    x: int
    y: float = 2.0


def test_json_is_checked_against_a_type() -> None:
    assert parse_json(b'{"x": 1, "more": 3}', Point, "p.json") == Point(1, 2.0)
    with pytest.raises(DataError, match=r"p\.json is not as expected: .*\$\.x"):
        parse_json(b'{"x": "one"}', Point, "p.json")
    for broken in (b"{", b"\xff\xfe", b'{"x": ' * 100_000, b'{"x": NaN}'):
        with pytest.raises(DataError, match=r"p\.json is not readable JSON"):
            parse_json(broken, dict[str, Any], "p.json")


def test_files_over_the_limit_and_what_is_no_file_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"1234")
    assert read_bytes(path, max_bytes=4) == b"1234"
    with pytest.raises(DataError, match="has 4 bytes; at most 3 are read"):
        read_bytes(path, max_bytes=3)
    with pytest.raises(DataError, match="is not a regular file"):
        check_file(tmp_path)
    with pytest.raises(DataError, match="does not exist"):
        read_bytes(tmp_path / "b")
    with pytest.raises(DataError, match="cannot read"):
        check_file(tmp_path / "a\0b")
    with pytest.raises(DataError, match="cannot read"):
        check_file(path / "c")


def test_the_limits_are_256_and_32_megabytes(tmp_path: Path) -> None:
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate(256 * 1024**2)  # sparse: takes no space
    check_file(path)
    with path.open("ab") as file:
        file.truncate(256 * 1024**2 + 1)
    with pytest.raises(DataError, match="at most 268435456 are read"):
        check_file(path)
    with path.open("wb") as file:
        file.truncate(32 * 1024**2 + 1)
    with pytest.raises(DataError, match="at most 33554432 are read"):
        read_json(path, dict[str, Any])


def test_the_arrays_of_a_large_field_are_read(tmp_path: Path) -> None:
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate(256 * 1024**2 + 1)
    with pytest.raises(DataError, match="is damaged"):  # not: too large
        read_arrays(path, dict[str, Any])
    with path.open("wb") as file:
        file.truncate(2 * 1024**3 + 1)
    with pytest.raises(DataError, match="at most 2147483648 are read"):
        read_arrays(path, dict[str, Any])


def test_a_file_that_cannot_be_opened_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").write_bytes(b"1")

    def refuse(self: Path) -> bytes:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", refuse)
    with pytest.raises(DataError, match=r"cannot read .*/a: .*Permission denied"):
        read_bytes(tmp_path / "a")


def test_arrays_and_their_header(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    arrays = {"transposed": np.arange(6).reshape(2, 3).T, "half": np.float16([0.5]), "mask": np.array([True, False])}
    write_arrays(path, arrays, {"x": 3})
    found, header = read_arrays(path, Point)
    assert header == Point(3) and found.keys() == arrays.keys()
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)
    write_arrays(path, arrays)
    assert read_arrays(path, dict[str, Any])[1] == {}
    with pytest.raises(DataError, match=r"the header of .*a\.safetensors is not as expected: .*`x`"):
        read_arrays(path, Point)
    save_file({"a": np.ones(2)}, path, {"header": "{"})  # a header that is no JSON
    with pytest.raises(DataError, match=r"the header of .* is not readable JSON"):
        read_arrays(path, Point)


def test_damaged_arrays_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    write_arrays(path, {"a": np.ones(100)})
    whole = path.read_bytes()
    for damaged in (whole[:-1], whole[:50], b"", b"hello", json.dumps({}).encode()):
        path.write_bytes(damaged)
        with pytest.raises(DataError, match=r"a\.safetensors is damaged, not a readable safetensors file"):
            read_arrays(path, dict[str, Any])
