"""The command `mcmc1d`: verify a kernel from a shell or a CI script; the verdict is the exit code."""

import argparse
import difflib
import importlib
import importlib.util
import inspect
import os
import sys
import sysconfig
import time
import traceback
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

from mcmc1d.whole import write_whole

_PASS, _FAIL, _USAGE, _INCONCLUSIVE = 0, 1, 2, 3
_PATIENCE = 2.0
"""Seconds after which progress is shown."""

_EXAMPLE = """\
example, with my_kernel.py in the current directory:

  import jax, jax.numpy as jnp
  from mcmc1d.verify.laws import two_modes

  log_density = two_modes().log_density

  def step(key, x):                       # one step of one chain
      a, b = jax.random.split(key)
      y = x + 2 * jax.random.normal(a)
      return jnp.where(jnp.log(jax.random.uniform(b)) < log_density(y) - log_density(x), y, x)

  mcmc1d verify my_kernel:step --target mcmc1d.verify.laws:two_modes --json step.json

exit codes: 0 PASS, 1 FAIL, 2 it could not be run, 3 INCONCLUSIVE
"""


class RequestError(Exception):
    """A request that can not be met; its words name the thing and the fix."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code, or raises `SystemExit` with it for what argparse handles."""
    options = _parser().parse_args(arguments)
    try:
        return options.run(options)
    except RequestError as error:
        return _refuse(str(error))
    except KeyboardInterrupt:
        return _refuse("interrupted", 130)


class _Parser(argparse.ArgumentParser):
    """One line for a mistake, without the usage."""

    def error(self, message: str) -> NoReturn:
        self.exit(_USAGE, f"{self.prog}: {message} (see {self.prog} --help)\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser("mcmc1d", description="Verification of Markov chain Monte Carlo kernels.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"mcmc1d {_version()}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    verify = commands.add_parser(
        "verify",
        help="whether a kernel leaves a law invariant",
        description="Whether a kernel leaves a law invariant, moves, and gets there; with the error rate of saying so.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    verify.set_defaults(run=_verify)
    thing = "MODULE:NAME or FILE.py:NAME; a function without parameters is called"
    verify.add_argument("kernel", metavar="KERNEL", help=f"what to verify: {thing}")
    verify.add_argument("--target", required=True, help=f"the law it should leave invariant: {thing}")
    verify.add_argument("--json", type=Path, metavar="FILE", help="write the report as a certificate")
    verify.add_argument("--plot", type=Path, metavar="FILE", help="write the report's figure (needs matplotlib)")
    verify.add_argument("--seed", type=_number(int, 0), default=0, metavar="N", help="default: 0")
    verify.add_argument(
        "--level", type=_number(float, 0, 0.5), metavar="L", help="probability that a right kernel fails; default: 1e-5"
    )
    verify.add_argument("--gap", type=_number(float, 0, 1), metavar="G", help="detect this gap in a coordinate's CDF")
    verify.add_argument("--power", type=float, metavar="P", help="with this probability; default: 0.99")
    verify.add_argument(
        "--seconds", type=_number(float, 0), metavar="S", help="what a first stage may take; default: 40"
    )
    verify.add_argument(
        "--replicas", type=_number(int, 1), metavar="N", help="of the first stage, in place of --gap and --seconds"
    )
    verify.add_argument("--reversible", action="store_true", help="hold it to detailed balance too")
    verify.add_argument(
        "--not-ergodic", action="store_true", help="it is only a part of a kernel, such as half a sweep"
    )
    verify.add_argument("--x64", action="store_true", help="in double precision")
    return parser


def _number(kind: Callable[[str], Any], least: float, most: float = float("inf")) -> Callable[[str], Any]:
    """A type for argparse: of this kind, and between the two; a float lies strictly between."""

    def parse(text: str) -> Any:
        value = kind(text)
        if not (least <= value < most) or (kind is float and value == least):
            words = f"over {least:g}" if kind is float else f"{least:g} or more"
            raise argparse.ArgumentTypeError(
                words + (f" and under {most:g}" if most < float("inf") else "") + f": {text}"
            )
        return value

    parse.__name__ = "whole number" if kind is int else "number"  # argparse names it in "invalid ... value"
    return parse


def _verify(options: argparse.Namespace) -> int:
    """`mcmc1d verify`."""
    _check_output(options)
    if (here := os.getcwd()) not in sys.path:
        sys.path.insert(0, here)  # a console script's own path starts at the script
    import jax

    from mcmc1d.verify import Verdict, verify

    if options.x64:
        jax.config.update("jax_enable_x64", True)
    target, kernel = _resolve("--target", options.target), _resolve("KERNEL", options.kernel)
    names = ("seed", "level", "gap", "power", "seconds", "replicas")
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    progress = _Progress()
    try:
        report = verify(
            kernel,
            target,
            reversible=True if options.reversible else None,
            ergodic=not options.not_ergodic,
            progress=progress,
            **given,
        )
    except ValueError as error:  # LawError is one
        raise RequestError(f"{options.kernel} on {options.target}: {_words(error)}") from error
    except (Exception, SystemExit) as error:
        progress.clear()
        traceback.print_exc()  # a mistake in the kernel: where it is matters more than one line
        raise RequestError(f"{options.kernel} on {options.target} raised {_words(error)}") from error
    finally:
        progress.clear()
    try:
        if options.json is not None:
            write_whole(options.json, lambda path: path.write_text(report.to_json() + "\n"))
        if options.plot is not None:
            write_whole(options.plot, lambda path: report.plot().savefig(path))
    except OSError as error:
        raise RequestError(f"{error.filename}: can not be written: {error.strerror}") from error
    try:
        print(report, flush=True)
    except BrokenPipeError:  # whoever reads has read enough, as `head` does; the verdict is in the exit code
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return {Verdict.PASS: _PASS, Verdict.FAIL: _FAIL, Verdict.INCONCLUSIVE: _INCONCLUSIVE}[report.verdict]


def _check_output(options: argparse.Namespace) -> None:
    """Refuse before the work what could not be written after it."""
    for path in (options.json, options.plot):
        if path is not None and not os.access(path.parent, os.W_OK):
            raise RequestError(f"{path}: {path.parent} is no folder that can be written to; make it first")
        if path is not None and path.is_dir():
            raise RequestError(f"{path} is a folder; name a file in it")
    if options.plot is not None:
        if importlib.util.find_spec("matplotlib") is None:
            raise RequestError("--plot needs matplotlib: pip install matplotlib")
        os.environ.setdefault("MPLBACKEND", "Agg")  # no window
        from matplotlib.backend_bases import FigureCanvasBase

        known = FigureCanvasBase.get_supported_filetypes()
        if options.plot.suffix[1:].lower() not in known:
            raise RequestError(f"--plot {options.plot}: end its name in one of .{', .'.join(sorted(known))}")


def _resolve(argument: str, place: str) -> Any:
    """The object at MODULE:NAME or FILE.py:NAME, or what it returns if it is a function without parameters."""
    where, _, name = place.rpartition(":")
    if not where or not name:
        raise RequestError(f"{argument} must be MODULE:NAME or FILE.py:NAME, not {place!r}")
    found: Any = _file(where) if where.endswith(".py") else _module(where)
    path = where
    for part in name.split("."):
        if not hasattr(found, part):
            raise RequestError(f"{path} has no {part!r}{_near(part, dir(found))}")
        found, path = getattr(found, part), f"{path}:{part}" if path == where else f"{path}.{part}"
    if (inspect.isfunction(found) or inspect.ismethod(found)) and not inspect.signature(found).parameters:
        try:
            return found()
        except (Exception, SystemExit) as error:
            raise RequestError(f"{place}() raised {_words(error)}") from error
    return found


def _module(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name and (name == error.name or name.startswith(f"{error.name}.")):
            raise RequestError(
                f"there is no module {error.name!r} in the current directory or the environment; a file is named "
                "FILE.py:NAME"
            ) from error
        raise RequestError(f"{name} can not be imported: {_words(error)}") from error
    except (Exception, SystemExit) as error:  # sys.exit(0) must not be read as PASS
        raise RequestError(f"{name} can not be imported: {_words(error)}") from error


def _file(name: str) -> ModuleType:
    """The module in a file, imported once; its neighbours are importable, as they are to `python FILE.py`."""
    path = Path(name).resolve()
    if not path.is_file():
        raise RequestError(f"there is no file {name}")
    label = f"{path.stem} ({path})"  # in sys.modules, where it must hide no other module
    if label in sys.modules:
        return sys.modules[label]
    if str(path.parent) not in sys.path:
        sys.path.insert(0, str(path.parent))
    spec = importlib.util.spec_from_file_location(label, path)
    assert spec is not None, path  # a name in .py has a loader
    assert spec.loader is not None, path
    sys.modules[label] = module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[label]
        raise RequestError(f"{name} can not be imported: {_words(error)}") from error
    return module


def _near(name: str, names: Sequence[str]) -> str:
    """Words on what was perhaps meant."""
    public = [other for other in names if not other.startswith("_")]
    close = difflib.get_close_matches(name, public, n=3)
    return (
        f"; did you mean {' or '.join(close)}?" if close else f"; it has {', '.join(public[:8]) or 'no public names'}"
    )


def _words(error: BaseException) -> str:
    """An exception in one line, with the line of the user's code that it comes from."""
    text = " ".join(str(error).split()) or "no message"
    library = (str(Path(__file__).parent), sysconfig.get_path("stdlib"), sysconfig.get_path("purelib"), "<")
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not f.filename.startswith(library)]
    where = f" ({frames[-1].filename}, line {frames[-1].lineno})" if frames else ""
    kind = "" if type(error).__name__ in ("ValueError", "LawError") else f"{type(error).__name__}: "
    return kind + text + where


class _Progress:
    """A line on a terminal's standard error, once it takes longer."""

    def __init__(self):
        self.began, self.width = time.monotonic(), 0

    def __call__(self, done: int, total: int) -> None:
        if sys.stderr.isatty() and time.monotonic() - self.began > _PATIENCE:
            text = f"{done:,} of {total:,} replicas, {done / total:.0%}"
            self.width = max(self.width, len(text))
            print("\r" + text.ljust(self.width), end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Take the line away."""
        if self.width:
            print("\r" + " " * self.width + "\r", end="", file=sys.stderr, flush=True)
            self.width = 0


def _refuse(message: str, code: int = _USAGE) -> int:
    print(f"mcmc1d: {message}", file=sys.stderr)
    return code


def _version() -> str:
    try:
        return version("mcmc1d")
    except PackageNotFoundError:
        return "(not installed)"


if __name__ == "__main__":
    sys.exit(main())
