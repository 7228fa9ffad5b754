"""`python -m experiments`: list and run the experiments, show their claims."""

import dataclasses
import gc
import json
import re
import time
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import typer
import xarray as xr
from rich.console import Console

from experiments.support import framework
from experiments.support.beside import side_by_side
from experiments.support.long import at
from experiments.support.progress import bars
from experiments.support.sweep import Sweep, checkpoints, journal, keep_compiled

app = typer.Typer(
    help="Reproduce the papers' experiments: figures, data and claims with verdicts.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
console, errors = Console(), Console(stderr=True)

Out = Annotated[Path, typer.Option(help="Where results are written, and read from.")]


@app.command("list")
def list_() -> None:
    """List the experiments, their profiles and the fields that --set knows."""
    for name in framework.names():
        module = framework.load(name)
        console.print(f"[bold]{name}[/]: {(module.__doc__ or '').splitlines()[0]}")
        for profile, config in module.PROFILES.items():
            console.print(f"  {profile}: {config}", highlight=False, soft_wrap=True)


@app.command()
def run(
    names: Annotated[list[str] | None, typer.Argument(help="Which experiments; see `list`.")] = None,
    all_: Annotated[bool, typer.Option("--all", help="Every experiment.")] = False,
    profile: Annotated[str, typer.Option(help="quick (a minute or so each) or paper.")] = "quick",
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="The same seed gives the same numbers.")] = 0,
    out: Out = Path("figures"),
    set_: Annotated[list[str] | None, typer.Option("--set", help="Override a field: name=value, repeatable.")] = None,
    jobs: Annotated[int, typer.Option(help="Processes, pinned to a core each, for sweeps and experiments.")] = 1,
    dask: Annotated[str | None, typer.Option(help="A Dask scheduler, tcp://..., whose workers share a sweep.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Take up what an interrupted run has left.")] = False,
) -> None:
    """Run experiments: write NAME.png, .pdf, .nc and .json; exit 1 where a verdict is not what is expected of it."""
    if bool(names) == all_:
        raise ValueError("name the experiments to run, or say --all")
    chosen = framework.names() if all_ else list(names or [])
    # Everything that can be wrong with the request is found before the first experiment spends its time.
    todo = []
    for name in chosen:
        module = framework.load(name)
        todo.append((name, module, framework.configure(module, profile, set_ or [])))
    framework.require_writable(out)
    if jobs > 1 and len(todo) > 1:
        options = ["--profile", profile, "--seed", str(seed), "--out", str(out)]
        options += [part for field in set_ or [] for part in ("--set", field)] + ["--resume"] * resume
        options += [] if dask is None else ["--dask", dask]
        # The long ones first, lest one is left over when all else is done.
        todo.sort(key=lambda one: not getattr(one[1], "LONG", False))
        raise typer.Exit(_beside([(name, getattr(module, "ALONE", False)) for name, module, _ in todo], options, jobs))
    framework.style()
    surprises, undecided = [], []
    for name, module, config in todo:
        began = time.perf_counter()
        kind = {"experiment": name, "config": dataclasses.asdict(config), "seed": seed}
        with journal(out / f".{name}.journal", kind, resume) as kept:
            try:
                with bars(errors) as show, at(str(kept.path), show):
                    data = module.run(config, seed, Sweep(show, kept, jobs, dask))
            except KeyboardInterrupt:
                saved = f"{len(kept)} finished parts and {len(checkpoints(kept.path))} checkpoints"
                errors.print(
                    f"{name}: interrupted; {saved} are kept: go on with the same command and --resume", soft_wrap=True
                )
                raise typer.Exit(130) from None
            claims = module.judge(data)
            record = framework.manifest(name, profile, config, seed, claims)
            paths = framework.write(out, name, data, module.draw(data), record)
        console.print(module.table(data))
        _print_claims(claims)
        # Said and not written: the same numbers give the same files.
        where, took = ", ".join(str(path) for path in paths), time.perf_counter() - began
        console.print(f"{name}, seed {seed}, {took:.0f} s: {where}", highlight=False, soft_wrap=True)
        surprises += [claim for claim in claims if not claim.as_expected]
        undecided += [claim.id for claim in claims if claim.verdict == "open"]
    if undecided:
        errors.print(f"[yellow]open, with these numbers of samples: {', '.join(undecided)}[/]", soft_wrap=True)
    for claim in surprises:
        errors.print(f"[red]{claim.id}: {claim.verdict}, and {claim.expected} is expected: {claim.number}[/]")
    if surprises:
        raise typer.Exit(1)


def _beside(chosen: list[tuple[str, bool]], options: list[str], jobs: int) -> int:
    """Run experiments in processes side by side; after them those that measure time, one by one. The exit code."""
    together = [["run", name, *options] for name, alone in chosen if not alone]
    lonely = [["run", name, "--jobs", str(jobs), *options] for name, alone in chosen if alone]
    code, count = 0, 0
    with bars(errors) as show:

        def done(_: int, out: str, err: str) -> None:
            nonlocal count
            count += 1
            show("experiments", count, len(chosen))
            for text, where in ((out, console), (err, errors)):
                if text:
                    where.print(text.rstrip("\n"), markup=False, highlight=False, soft_wrap=True)

        show("experiments", 0, len(chosen))
        for parts, at_once in ((together, jobs), *(([part], 1) for part in lonely)):
            if parts:
                code = max(code, side_by_side("experiments", parts, at_once, done))
    return code


@app.command()
def draw(
    names: Annotated[list[str], typer.Argument(help="Which experiments; see `list`.")], out: Out = Path("figures")
):
    """Draw again, and judge again, from the data of the last run."""
    framework.require_writable(out)
    framework.style()
    for name in names:
        module = framework.load(name)
        _judged(name, module, *framework.read(out, name), out)


@app.command()
def join(
    name: Annotated[str, typer.Argument(help="Which experiment; see `list`.")],
    folders: Annotated[list[Path], typer.Argument(help="The folders, --out, of two runs or more.")],
    out: Out = Path("figures"),
) -> None:
    """Join runs that differ in one list, of scenes or of integrators: what ran on several machines, or days."""
    framework.require_writable(out)
    framework.style()
    module = framework.load(name)
    data, record = framework.joined(name, folders)
    _judged(name, module, data, record, out)


def _judged(name: str, module: ModuleType, data: xr.Dataset, record: dict[str, Any], out: Path) -> None:
    """Judge, draw, write and show."""
    found = module.judge(data)
    record["claims"] = [vars(claim) for claim in found]
    framework.write(out, name, data, module.draw(data), record)
    console.print(module.table(data))
    _print_claims(found)


@app.command()
def scene(
    names: Annotated[list[str], typer.Argument(help="Of the catalogue, or scene files NAME.toml.")],
    edges: Annotated[int, typer.Option(help="The paths' edges: 1 is a lamp that is seen directly.")] = 3,
    paths: Annotated[int, typer.Option(help="How many paths that carry light, of each technique at most.")] = 30,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Of the paths.")] = 0,
    out: Out = Path("figures"),
) -> None:
    """Draw flatland scenes, each with paths by technique, into scene_NAME.png."""
    from experiments.support.flatland import draw_techniques
    from mcmc1d.flatland import files, scenes

    framework.require_writable(out)
    framework.style()
    for name in names:
        shown = files.read(Path(name)) if name.endswith(".toml") else scenes.scene(name)
        plain = re.sub(r"[^-.\w]", "_", shown.name)  # a name may hold what no file's may
        path = out / f"scene_{plain}.png"
        draw_techniques(shown, edges, paths, seed).savefig(path, metadata={"Software": None})
        console.print(str(path), highlight=False, soft_wrap=True)


@app.command()
def claims(
    out: Out = Path("figures"),
    json_: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="As the README's table.")] = False,
    write: Annotated[Path | None, typer.Option(help="Put the table into a document, between its marks.")] = None,
) -> None:
    """Show the claims checked so far, from the results of the last runs."""
    found = framework.read_claims(out)
    if write is not None:
        framework.rewrite(write, found, framework.origins(out))
    elif json_:
        print(json.dumps([vars(claim) for claim in found], indent=2))
    elif markdown:
        print("\n".join(framework.markdown(found, framework.origins(out))))
    else:
        _print_claims(found)


@app.command()
def bench(
    profile: Annotated[str, typer.Option(help="quick (two minutes) or paper.")] = "quick",
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Kept with the results.")] = 0,
    out: Out = Path("figures"),
    set_: Annotated[list[str] | None, typer.Option("--set", help="Override a field: name=value, repeatable.")] = None,
    json_: Annotated[bool, typer.Option("--json", help="The ratios as JSON.")] = False,
) -> None:
    """Time this library against others in one run, pinned to one core; write bench.png, .pdf, .nc and .json."""
    from experiments.support import bench as measured

    config = framework.configure(measured, profile, set_ or [])
    framework.require_writable(out)
    framework.style()
    with bars(errors) as show:
        data = measured.run(config, seed, show)
    ratios = measured.headline(data)
    record = {**framework.manifest("bench", profile, config, seed, []), "ratios": ratios, "machine": measured.machine()}
    paths = framework.write(out, "bench", data, measured.draw(data), record)
    if json_:
        print(json.dumps(ratios, indent=2))
        return
    console.print(measured.table(data))
    console.print(", ".join(str(path) for path in paths), highlight=False, soft_wrap=True)


def _print_claims(found: list[framework.Claim]) -> None:
    for c in found:
        colour = "yellow" if c.verdict == "open" else "green" if c.as_expected else "red"
        console.print(
            f"[{colour}]{c.verdict:>6}[/]  [bold]{c.id}[/]: {c.statement} [dim]({c.source})[/]", highlight=False
        )
        console.print(f"        {c.number}; {c.tolerance}", highlight=False)


def main() -> None:
    """The command line: what a user got wrong is one line and exit code 2."""
    # Tracing makes objects by the million that stay: they are looked through for garbage less often, 3 % of the time.
    gc.set_threshold(100_000)
    # Compiled code is kept between runs, here and not in the library: a program's settings are the program's.
    keep_compiled()
    try:
        app(standalone_mode=True)
    except ValueError as error:
        errors.print(f"error: {error}", style="red", markup=False, highlight=False, soft_wrap=True)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
