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
        error.filename = os.fspath(path)  # the temporary file's name tells a user nothing
        raise
    finally:
        temporary.unlink(missing_ok=True)
