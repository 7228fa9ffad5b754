"""What all experiments share: finding them, configuring them, and writing what they find, whole or not at all."""

import dataclasses
import importlib
import json
import math
import pkgutil
import platform
import subprocess
import tempfile
import typing
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import matplotlib
import matplotlib.style
import xarray as xr
from matplotlib.figure import Figure

import experiments
from mcmc1d.checks import require

PACKAGES = ("mcmc1d", "jax", "jaxlib", "equinox", "numpy", "scipy", "matplotlib", "emcee", "xarray")
STYLE = Path(__file__).with_name("paper.mplstyle")


@dataclasses.dataclass(frozen=True)
class Claim:
    """A claim of a paper, and what was found."""

    id: str
    statement: str
    source: str
    """The paper and the equation, section or figure."""
    verdict: str
    """"holds", "holds if ...", "fails", or "open" where the noise leaves it undecided."""
    expected: str
    """The verdict that theory or the paper predicts; where the plane was found to differ, what was found before.

    A run whose verdict is another has failed: a change is news. What the paper says stands in the claim itself.
    """
    number: str
    """What was measured, with its unit."""
    tolerance: str
    """What it was held to: the level of the test and the smallest error that it would have caught."""

    @property
    def as_expected(self) -> bool:
        """Whether this is what was expected, or says neither."""
        return self.verdict in (self.expected, "open")


def names() -> list[str]:
    """Every experiment: the modules that stand in the folder `experiments` itself."""
    found = pkgutil.iter_modules(experiments.__path__)
    return sorted(module.name for module in found if not module.ispkg and not module.name.startswith("_"))


def chosen(text: str, known: Mapping[str, Any], *, none: bool = False) -> list[str]:
    """The names in a configuration's list, or with "all" all that are known; `ValueError` where one is not.

    `none`: whether there may be none.
    """
    named = list(known) if text == "all" else text.split()
    wrong = [name for name in named if name not in known]
    twice = sorted({name for name in named if named.count(name) > 1})
    require(not twice, f"{', '.join(twice)} stands twice in {text!r}")
    require(
        (none or len(named) > 0) and not wrong,
        f"there is no {', '.join(wrong) or repr(text)}; known: {', '.join(known)}",
    )
    return named


def numbers(name: str, text: str, kind: type = int) -> list[Any]:
    """The positive numbers in the configuration's list `name`; `ValueError` where there is none, or one is not that."""
    try:
        found = [kind(part) for part in text.split()]
    except ValueError:
        found = []
    wanted = "whole numbers" if kind is int else "numbers"
    positive = all(0 < number < math.inf for number in found)
    require(len(found) > 0 and positive, f"{name} takes positive {wanted} with spaces between them, not {text!r}")
    return found


def between(shortest: int, longest: int) -> list[int]:
    """The path lengths of a configuration; `ValueError` where there is none."""
    require(1 <= shortest <= longest, f"shortest={shortest} must be 1 at least, and longest={longest} no less")
    return list(range(shortest, longest + 1))


def load(name: str) -> ModuleType:
    """The module of an experiment; `ValueError` lists the known ones."""
    require(name in names(), f"there is no experiment {name!r}; known: {', '.join(names())}")
    return importlib.import_module(f"experiments.{name}")


def configure(experiment: Any, profile: str, overrides: list[str]) -> Any:
    """The profile's configuration with each `name=value` of the overrides in place.

    Values are read as the field's type. Raises `ValueError` for an unknown profile or field (naming the known ones)
    and for a value that does not fit.
    """
    profiles = experiment.PROFILES
    require(profile in profiles, f"there is no profile {profile!r}; known: {', '.join(profiles)}")
    config = profiles[profile]
    types = typing.get_type_hints(type(config))
    changes: dict[str, Any] = {}
    for override in overrides:
        name, sign, text = override.partition("=")
        require(sign == "=", f"--set takes name=value, not {override!r}")
        require(name in types, f"the configuration has no field {name!r}; known: {', '.join(types)}")
        try:
            changes[name] = _read(types[name], text)
        except ValueError:
            raise ValueError(f"--set {name}: {text!r} is not {types[name].__name__}") from None
    return dataclasses.replace(config, **changes)


def _read(kind: type, text: str) -> Any:
    if kind is bool:
        if text.lower() not in ("true", "false"):
            raise ValueError(text)
        return text.lower() == "true"
    return kind(text)


def manifest(name: str, profile: str, config: Any, seed: int, claims: list[Claim]) -> dict[str, Any]:
    """All that it takes to get the same numbers again, and what they said."""
    return {
        "experiment": name,
        "profile": profile,
        "config": dataclasses.asdict(config),
        "seed": seed,
        "versions": {"python": platform.python_version(), **{package: version(package) for package in PACKAGES}},
        "commit": _commit(),
        "claims": [dataclasses.asdict(claim) for claim in claims],
    }


def origins(out: Path) -> str:
    """Of which profile and seed the last run of each experiment is, in a sentence."""
    profiles: dict[str, list[str]] = {}
    for record in _records(out):
        if record.get("claims"):
            seed = f" (seed {record['seed']})" if record["seed"] else ""
            profiles.setdefault(record["profile"], []).append(f"`{record['experiment']}`{seed}")
    parts = "; ".join(f"of the {profile} profile {', '.join(names)}" for profile, names in sorted(profiles.items()))
    return f"Results {parts}; at seed 0 unless said."


def _records(out: Path) -> list[dict[str, Any]]:
    return [json.loads(path.read_text()) for path in sorted(out.glob("*.json"))]


def read_claims(out: Path) -> list[Claim]:
    """The claims of the last run of each experiment, from the manifests in `out`."""
    records = _records(out)
    found = [Claim(**claim) for record in records for claim in record.get("claims", [])]
    require(bool(found), f"no results in {out}; run `python -m experiments run --all` first")
    return found


def read(out: Path, name: str) -> tuple[xr.Dataset, dict[str, Any]]:
    """The data and the manifest of the last run of an experiment; `ValueError` where there is none."""
    require((out / f"{name}.json").exists(), f"no results of {name} in {out}; run `python -m experiments run {name}`")
    return xr.load_dataset(out / f"{name}.nc", engine="h5netcdf"), json.loads((out / f"{name}.json").read_text())


def joined(name: str, folders: Sequence[Path]) -> tuple[xr.Dataset, dict[str, Any]]:
    """The data and the manifest, without claims, of runs that differ in one list of names: of scenes, of integrators.

    The list `scenes` of the configuration is the dimension `scene` of the data. `ValueError` where the runs have other
    differences, or where two have done the same.
    """
    found = [read(folder, name) for folder in folders]
    datasets, records = [data for data, _ in found], [record for _, record in found]
    for part in ("profile", "seed", "versions"):
        same = all(record[part] == records[0][part] for record in records)
        require(same, f"join: the runs of {name} differ in their {part}; only what differs in one list can be joined")
    configs = [record["config"] for record in records]
    differs = sorted({field for config in configs for field in config if config[field] != configs[0][field]})
    dimension = differs[0].removesuffix("s") if len(differs) == 1 else ""
    require(
        all(dimension in data.dims for data in datasets),
        f"join: runs of {name} must differ in one list of names, such as scenes, not in {', '.join(differs) or 'none'}",
    )
    labels = [str(label) for data in datasets for label in data[dimension].to_numpy()]
    twice = sorted({label for label in labels if labels.count(label) > 1})
    require(not twice, f"join: two runs of {name} have {', '.join(twice)}")
    try:
        # What has no such dimension is of all of them. Labels of fixed width would be cut to that of the first.
        parts = [data.drop_attrs().drop_vars(dimension) for data in datasets]
        data = xr.concat(parts, dimension, data_vars="minimal", compat="equals", join="exact")
    except ValueError as error:
        raise ValueError(f"join: the runs of {name} do not agree in what they have in common: {error}") from None
    data = data.assign_coords({dimension: labels})
    commits = dict.fromkeys(record["commit"] for record in records)
    config = {**configs[0], differs[0]: " ".join(labels)}
    return data, {**records[0], "config": config, "commit": ", ".join(commits), "claims": []}


def markdown(claims: list[Claim], where: str) -> list[str]:
    """The lines of the README's table, and where it is from."""
    cells = [(f"`{c.id}`", c.statement, c.source, f"**{c.verdict}**", c.number, c.tolerance) for c in claims]
    rows = [" | ".join(cell.replace("|", r"\|") for cell in row) for row in cells]
    head = ["| id | claim | source | verdict | measured | held to |", "| --- | --- | --- | --- | --- | --- |"]
    return [where, "", *head, *(f"| {row} |" for row in rows)]


def rewrite(document: Path, claims: list[Claim], where: str) -> None:
    """Put the table between the two `claims` marks of a document; `ValueError` where it has none."""
    opening, closing = "<!-- claims -->\n", "\n<!-- /claims -->"
    before, mark, rest = document.read_text().partition(opening) if document.exists() else ("", "", "")
    _, end, after = rest.partition(closing)
    require(bool(mark and end), f"{document} has no lines {opening.strip()} and {closing.strip()} to write between")
    document.write_text(before + opening + "\n".join(markdown(claims, where)) + closing + after)


def write(out: Path, name: str, data: xr.Dataset, figure: Figure, record: Mapping[str, Any]) -> list[Path]:
    """NAME.png, .pdf, .nc and .json in `out`, made under other names and renamed once all are whole.

    The .json is removed first and renamed last: it is the commit mark, and where there is one its companions are
    those of its run, whatever was killed in between.
    """
    attributes = {key: value if isinstance(value, str | int) else json.dumps(value) for key, value in record.items()}
    # Beside `out`, so that a rename stays on one file system; the leading dot keeps a half-made one out of sight.
    with tempfile.TemporaryDirectory(prefix=f".{name}-", dir=out) as folder:
        made = [Path(folder) / f"{name}{suffix}" for suffix in (".png", ".pdf", ".nc", ".json")]
        # No dates inside: the same numbers give the same files.
        figure.savefig(made[0], metadata={"Software": None})
        figure.savefig(made[1], metadata={"CreationDate": None})
        data.assign_attrs(attributes).to_netcdf(made[2], engine="h5netcdf")
        made[3].write_text(json.dumps(record, indent=2) + "\n")
        (out / made[3].name).unlink(missing_ok=True)
        return [path.replace(out / path.name) for path in made]


def require_writable(out: Path) -> None:
    """Make the output directory, or raise `ValueError` that says why not."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=out, prefix=".probe-"):
            pass
    except OSError as error:
        raise ValueError(f"can not write to {out}: {error.strerror}; name another with --out") from None


def style() -> None:
    """The one style of all figures."""
    matplotlib.use("Agg")
    matplotlib.style.use(STYLE)


def _commit() -> str:
    """The git commit of this checkout, "+" after it if files differ from it; "unknown" outside one."""
    git = ["git", "-C", str(Path(__file__).parent)]
    try:
        head = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
        changed = ["diff", "--quiet", "HEAD", "--", ":!figures"]
        return head + ("+" if subprocess.run([*git, *changed], check=False, capture_output=True).returncode else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


__all__ = [
    "Claim",
    "configure",
    "joined",
    "load",
    "manifest",
    "markdown",
    "names",
    "read",
    "read_claims",
    "require_writable",
    "rewrite",
    "style",
    "write",
]
