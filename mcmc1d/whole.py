"""Files that are whole or not there."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any


def write_whole(path: Path, save: Callable[[Path], Any]) -> None:
    """`save(temporary path)` beside `path`, then renamed: a killed process leaves the old file.

    Raises `OSError`, of `path`.
    """
    temporary = path.with_name(f".{os.getpid()}-{path.name}")
    try:
        save(temporary)
        temporary.replace(path)
    except OSError as error:
        if error.errno is not None:  # the temporary file's name tells a user nothing
            error.filename, error.filename2 = os.fspath(path), None
        raise
    finally:
        temporary.unlink(missing_ok=True)
