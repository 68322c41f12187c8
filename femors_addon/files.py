# SPDX-License-Identifier: GPL-3.0-or-later
"""Files as a whole: read with one-line errors, written so that none is ever left half done."""

from __future__ import annotations

import contextlib
import os
import stat
import uuid
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .progress import FemorsError

Location = str | os.PathLike[str]


def read_bytes(path: Location) -> bytes:
    """Return the content of a regular file that is not empty.

    Raises
    ------
    FemorsError
        Missing, a folder, a device, not readable, or empty.
    """
    if "\0" in os.fspath(path):
        raise FemorsError(f"{os.fspath(path)!r}: is not a file name")
    try:
        mode = os.stat(path).st_mode
        if stat.S_ISDIR(mode):
            raise FemorsError(f"{path}: is a folder; name a file")
        if not stat.S_ISREG(mode):
            raise FemorsError(f"{path}: is not a regular file")
        data = Path(path).read_bytes()
    except OSError as error:
        raise FemorsError(f"{path}: cannot be read ({_reason(error)})") from None
    if not data:
        raise FemorsError(f"{path}: is empty")
    return data


def check_no_folder(path: Location) -> None:
    """Raise `FemorsError` for a folder: before its name is found to lack a file's ending."""
    if "\0" not in os.fspath(path) and os.path.isdir(path):
        raise FemorsError(f"{path}: is a folder; name a file")


def check_writable(*paths: Location) -> None:
    """Raise `FemorsError` unless a file can be written at each path; leaves nothing behind."""
    for path in paths:
        temporary = _temporary(path)
        try:
            temporary.touch(exist_ok=False)
            temporary.unlink()
        except OSError as error:
            raise _not_written(path, error) from None


@contextlib.contextmanager
def replacing(*paths: Location) -> Iterator[list[Path]]:
    """Give a temporary path beside each of `paths`; move all of them into place if all went well.

    The body writes every temporary file. When it raises, whatever it raises, the temporary files are
    removed and the files at `paths` are what they were.

    Raises
    ------
    FemorsError
        A folder that is missing or read-only, a disk that is full.
    """
    temporary = [_temporary(path) for path in paths]
    at: Location = paths[0] if paths else ""
    try:
        yield temporary
        for at, new in zip(paths, temporary, strict=True):
            os.replace(new, os.path.realpath(at))
    except OSError as error:
        named = {os.fspath(new): path for new, path in zip(temporary, paths, strict=True)}
        if error.filename is None:  # while it was written: the last that was begun
            begun = [path for new, path in zip(temporary, paths, strict=True) if new.exists()]
            at = begun[-1] if begun else at
        raise _not_written(named.get(str(error.filename), at), error) from None
    finally:
        for new in temporary:
            with contextlib.suppress(OSError):  # moved into place, or never written
                new.unlink()


def check_folder(folder: Location) -> None:
    """Raise `FemorsError` unless a folder is there or can be made: before a long computation."""
    if "\0" in os.fspath(folder):
        raise FemorsError(f"{os.fspath(folder)!r}: is not a file name")
    there = Path(os.path.realpath(folder))
    if there.exists() and not there.is_dir():
        raise FemorsError(f"{folder}: is a file; name a folder")
    while not there.exists():
        there = there.parent
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        raise FemorsError(f"{folder}: cannot be made, for {there} is no folder that can be written to")


@contextlib.contextmanager
def folder_for(folder: Location) -> Iterator[None]:
    """Make a folder, with those that it is in, for files that the body writes.

    Where they fail, or one of the folders does, those that were made go again.
    """
    made: list[Path] = []
    try:
        _make(folder, made)
        yield
    except BaseException:
        for path in reversed(made):
            with contextlib.suppress(OSError):  # something else stands in it by now
                path.rmdir()
        raise


def _make(folder: Location, made: list[Path]) -> None:
    """Make a folder and those that it is in, and tell which; raise `FemorsError` where one cannot be."""
    try:
        for path in (*reversed(Path(folder).parents), Path(folder)):
            if not path.is_dir():
                path.mkdir()
                made.append(path)
    except OSError as error:
        raise FemorsError(f"{folder}: cannot be made ({_reason(error)})") from None


def write_bytes(path: Location, data: bytes) -> None:
    """Write a file, whole or not at all."""
    with replacing(path) as (new,):
        new.write_bytes(data)


def _temporary(path: Location) -> Path:
    """Return an unused name beside the file that `path` stands for (links are followed)."""
    if "\0" in os.fspath(path):
        raise FemorsError(f"{os.fspath(path)!r}: is not a file name")
    final = Path(os.path.realpath(path))
    if final.is_dir():
        raise FemorsError(f"{path}: is a folder; name a file in it")
    if not final.parent.is_dir():
        raise FemorsError(f"{path}: there is no folder {final.parent}; make it first")
    if final.exists() and not (final.is_file() and os.access(final, os.W_OK)):
        raise FemorsError(f"{path}: is write-protected or no regular file; choose another name")
    # the suffix stays last: numpy.savez appends one to names that lack it
    return final.with_name(f".{final.stem[:80]}.{uuid.uuid4().hex[:12]}{final.suffix}")


def _not_written(path: Location, error: OSError) -> FemorsError:
    return FemorsError(f"{path}: cannot be written ({_reason(error)})")


def _reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()


# --- numbers in text ------------------------------------------------------------------------------


class BadNumber(ValueError):
    """A token that is not a number; `index` says which of those given."""

    def __init__(self, index: int, text: bytes) -> None:
        super().__init__(f"'{shown(text)}' is not a number")
        self.index = index


def floats(tokens: Sequence[bytes]) -> NDArray[np.float64]:
    """Return (k,) the numbers that the tokens spell; raises `BadNumber` for the first that does not."""
    try:
        out = np.fromiter(map(float, tokens), np.float64, len(tokens))
    except ValueError:
        raise _first_bad(tokens, float) from None
    return _plain(tokens, out)


def integers(tokens: Sequence[bytes]) -> NDArray[np.int64]:
    """Return (k,) the whole numbers that the tokens spell; raises `BadNumber`."""
    try:
        out = np.fromiter(map(int, tokens), np.int64, len(tokens))
    except (ValueError, OverflowError):
        raise _first_bad(tokens, _int64) from None
    return _plain(tokens, out)


def _plain(tokens: Sequence[bytes], out: NDArray) -> NDArray:
    # Python reads 1_000 as a thousand; a mesh file does not mean that
    if b"_" in b"".join(tokens):
        index = next(i for i, token in enumerate(tokens) if b"_" in token)
        raise BadNumber(index, tokens[index])
    return out


def _int64(token: bytes) -> int:
    value = int(token)
    if not -(2**63) <= value < 2**63:
        raise ValueError
    return value


def _first_bad(tokens: Sequence[bytes], kind: Callable[[bytes], float]) -> BadNumber:
    for index, token in enumerate(tokens):
        try:
            kind(token)
        except ValueError:
            return BadNumber(index, token)
    raise AssertionError("every token is a number")


def require_finite(positions: NDArray[np.float64], things: str, called: Callable[[int], str]) -> None:
    """Raise `FemorsError` where positions (n, 3) are not finite numbers.

    Parameters
    ----------
    things : str
        What has the positions: "vertices", "nodes".
    called : callable
        From the number of one, counted from 0, to what its file calls it.
    """
    bad = ~np.isfinite(positions).all(axis=1)
    if bad.any():
        raise FemorsError(
            f"{int(bad.sum())} of {len(bad)} {things} with coordinates that are not finite numbers "
            f"(first: {called(int(np.argmax(bad)))})"
        )


def shown(text: bytes, length: int = 30) -> str:
    """Return the beginning of some bytes as one line fit for a message."""
    plain = "".join(c if c.isprintable() else "?" for c in text[: 4 * length].decode("utf-8", "replace"))
    return plain if len(plain) <= length else plain[:length] + "..."


def looks_like_text(data: bytes) -> bool:
    """Whether the beginning of some bytes has only characters that text has."""
    head = data[:1024]
    return not any(byte < 32 and byte not in b"\t\n\v\f\r" for byte in head)
