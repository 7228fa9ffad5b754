"""The fixture `verify_kernel`: kernels verified in a test suite, under one false-alarm rate for the whole run.

    def test_my_kernel(verify_kernel):
        verify_kernel(step, law)

The run's level is shared evenly among the collected tests that name the fixture, before any is deselected, so that
`-k` changes no test's level. A test's calls get 1/2, 1/4, ... of its share, which never exceed it. Random numbers
derive from the run's seed, the test's name and the number of the call: neither the order nor the other tests matter.

Pytest imports this module at the start of every run; JAX is imported when the fixture is called.
"""

import contextlib
import hashlib
import json
import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from mcmc1d.whole import write_whole

_KEY = pytest.StashKey["_Share"]()
_PROPERTY = "mcmc1d"  # in a report's user_properties, which reach xdist's controller and JUnit's XML
_RETRIERS = {
    "pytest-rerunfailures": ("rerunfailures", "pytest_rerunfailures"),
    "flaky": ("flaky", "flaky.flaky_pytest_plugin"),
    "pytest-retry": ("pytest-retry", "pytest_retry.retry_plugin"),
}
"""Their names as plugins: by entry point, and by -p."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Each setting is an option, and an entry of the ini file that stands in for it."""
    group = parser.getgroup("mcmc1d", "verification of Markov chain Monte Carlo kernels (mcmc1d)")
    for name, metavar, default, text in (
        ("level", "P", "1e-4", "the probability that any right kernel of the whole run fails"),
        ("seed", "N", "0", "what all random numbers derive from, with the tests' names"),
        ("certificates", "DIR", "", "write a JSON file for each verification into this folder"),
        ("inconclusive", "{fail,skip}", "fail", "what becomes of a test whose verdict is INCONCLUSIVE"),
    ):
        shown = f"{text} (default: {default or 'none'})"
        group.addoption(f"--mcmc1d-{name}", metavar=metavar, default=None, help=shown)
        parser.addini(f"mcmc1d_{name}", shown, default=default)


def pytest_configure(config: pytest.Config) -> None:
    """Settings are read, and refused, before anything is collected."""
    config.pluginmanager.register(_Run.of(config), "mcmc1d-run")


@pytest.fixture
def verify_kernel(request: pytest.FixtureRequest) -> "VerifyKernel":
    """Verify that a kernel leaves a law invariant: `verify_kernel(kernel, law)` raises unless the verdict is PASS.

    Returns the `mcmc1d.verify.Report`. Takes the keywords of `mcmc1d.verify.verify` but level, seed and ledger, which
    are the run's; `must_fail=True` for a mutant, which has to FAIL.
    """
    item = request.node
    share = item.stash.get(_KEY, None)
    retrier = _retrier(item)
    if retrier:
        pytest.fail(
            f"verify_kernel can not be retried, and {retrier} would: a wrong kernel that is tried until it passes has "
            "passed nothing, and a failure reproduces from its seed. Take the test out of what is retried",
            pytrace=False,
        )
    if share is None:
        pytest.fail(
            "verify_kernel must stand among the arguments of the test, or of a fixture of it, so that its share of the "
            "run's level is set aside at collection; request.getfixturevalue comes too late",
            pytrace=False,
        )
    if share.taken:
        pytest.fail("verify_kernel can not be used in a second run of the same test: no retries", pytrace=False)
    share.taken = True
    return VerifyKernel(item, share)


@dataclass
class _Share:
    """What one test may spend."""

    run: "_Run"
    test: str
    level: float
    taken: bool = False
    calls: int = 0
    spending: int = 0
    """How many of the calls were of kernels that are meant to be right."""


class VerifyKernel:
    """What the fixture `verify_kernel` returns."""

    def __init__(self, item: pytest.Item, share: _Share):
        self._item, self._share = item, share

    def __call__(self, kernel: Any, target: Any, *, must_fail: bool = False, **settings: Any) -> Any:
        """Verify; see the fixture.

        Raises `VerificationError` with the report's text unless the verdict is PASS, or with `must_fail` unless it is
        FAIL; skips an INCONCLUSIVE one if the run says so. A law or kernel that can not be run raises `ValueError`.
        """
        __tracebackhide__ = True
        given = {"level", "seed", "ledger"} & settings.keys()
        if given:
            raise TypeError(
                f"verify_kernel sets {' and '.join(sorted(given))} itself, for all tests of a run: leave it out, and "
                "give pytest --mcmc1d-level or --mcmc1d-seed"
            )
        from mcmc1d.verify import Verdict, VerificationError, verify

        share, run = self._share, self._share.run
        share.calls += 1
        share.spending += not must_fail
        # A mutant is no right kernel, and spends nothing; it meets the level of the call before it.
        level = share.level * 0.5 ** max(share.spending, 1)
        seed = _seed(run.seed, share.test, share.calls)
        record = {
            "test": share.test,
            "call": share.calls,
            "must_fail": must_fail,
            "spent": 0.0 if must_fail else level,
            "verdict": "ERROR",
            "seed": seed,
        }
        try:
            report = verify(kernel, target, level=level, seed=seed, **settings)
            record |= {"verdict": report.verdict.value, "replicas": report.replicas, "power": report.power}
            record |= {"gap": report.gap if math.isfinite(report.gap) else None}  # JSON has no infinity
            run.certify(report, record)
        finally:
            # Also of a call that raises: the level is spent once the kernel has been looked at.
            self._item.user_properties.append((_PROPERTY, json.dumps(record)))
        if report.verdict is (Verdict.FAIL if must_fail else Verdict.PASS):
            return report
        again = f"pytest {share.test!r} --mcmc1d-seed={run.seed} --mcmc1d-level={share.level!r}"
        text = f"{report}\n  alone      {again}"
        if must_fail:
            text = f"this kernel must FAIL, and the verdict is {report.verdict.value}: the test is too weak\n{text}"
        if report.verdict is Verdict.INCONCLUSIVE and not must_fail and run.inconclusive == "skip":
            pytest.skip(text)
        raise VerificationError(text)


@dataclass(eq=False)  # plugins are told apart by identity
class _Run:
    """The settings of a run, and what its verifications have said so far."""

    level: float
    seed: int
    certificates: Path | None
    inconclusive: str
    records: list[dict] = field(default_factory=list)

    @staticmethod
    def of(config: pytest.Config) -> "_Run":
        """By the options, and the ini file where they are not given; raises `pytest.UsageError`."""

        def setting(name: str) -> tuple[str, str]:
            option = config.getoption(f"mcmc1d_{name}")
            return (
                (f"mcmc1d_{name} in the ini file", config.getini(f"mcmc1d_{name}"))
                if option is None
                else (f"--mcmc1d-{name}", option)
            )

        def number(name: str, kind: type, allowed: Any, words: str) -> Any:
            source, text = setting(name)
            with contextlib.suppress(ValueError):
                if allowed(kind(text)):
                    return kind(text)
            raise pytest.UsageError(f"{source} must be {words}, not {text!r}")

        source, inconclusive = setting("inconclusive")
        if inconclusive not in ("fail", "skip"):
            raise pytest.UsageError(f"{source} must be fail or skip, not {inconclusive!r}")
        level = number("level", float, lambda p: 0 < p < 0.5, "a probability between 0 and 0.5")
        seed = number("seed", int, lambda n: n >= 0, "a whole number from 0 on")
        return _Run(level, seed, _Run._folder(config, *setting("certificates")), inconclusive)

    @staticmethod
    def _folder(config: pytest.Config, source: str, text: str) -> Path | None:
        """Made at once: a run must not end by finding that it can not write what it was run for."""
        if not text:
            return None
        # An option is relative to where pytest was called, an entry of the ini file to that file.
        ini = None if source.startswith("--") else config.inipath
        folder = (config.invocation_params.dir if ini is None else ini.parent) / text
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise pytest.UsageError(f"{source}: can not make the folder {folder}: {error.strerror}") from error
        if ini is None:
            config.option.mcmc1d_certificates = str(folder)  # an xdist worker may stand elsewhere
        return folder

    @pytest.hookimpl(tryfirst=True)  # before tests are deselected, or renamed by xdist's groups
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        using = [item for item in items if "verify_kernel" in getattr(item, "fixturenames", ())]
        for item in using:
            item.stash[_KEY] = _Share(self, item.nodeid, self.level / len(using))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "teardown":
            self.records += [json.loads(str(value)) for key, value in report.user_properties if key == _PROPERTY]

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        if not self.records:
            return
        terminalreporter.section("mcmc1d: verified kernels")
        for record in sorted(self.records, key=lambda r: (r["test"], r["call"])):
            terminalreporter.line(_line(record))
        spent = sum(record["spent"] for record in self.records)
        terminalreporter.line(
            f"spent {spent:.1e} of the level {self.level:.1e}: the probability that any right kernel of this run "
            f"fails (seed {self.seed})"
        )

    def certify(self, report: Any, record: dict) -> None:
        """Write a certificate: the report, and whose it is."""
        if self.certificates is None:
            return
        whose = {
            "test": record["test"],
            "call": record["call"],
            "must_fail": record["must_fail"],
            "run_seed": self.seed,
        }
        words = re.sub(r"[^A-Za-z0-9.-]+", "_", record["test"])[:150]
        digest = hashlib.sha256(record["test"].encode()).hexdigest()[:8]  # two tests' words may be the same
        text = json.dumps(whose | json.loads(report.to_json()), indent=2, allow_nan=False)
        write_whole(self.certificates / f"{words}.{digest}.{record['call']}.json", lambda path: path.write_text(text))


def _seed(seed: int, test: str, call: int) -> int:
    """48 bits: a whole number that every reader of JSON keeps."""
    return int.from_bytes(hashlib.sha256(f"{seed}\n{test}\n{call}".encode()).digest()[:6], "big")


def _line(record: dict) -> str:
    """One verification in the terminal's summary."""
    verdict, name = record["verdict"], record["test"] + (f" (call {record['call']})" if record["call"] > 1 else "")
    if record["must_fail"]:
        name += ", which must fail"
    if "gap" not in record:
        return f"{verdict:<12}  {name}  level {record['spent']:.1e}  seed {record['seed']}"
    gap = "detects no gap"
    if record["gap"] is not None:
        gap = f"detects a gap of {record['gap']:.2g} with probability {record['power']:g}"
    return (
        f"{verdict:<12}  {name}  level {record['spent']:.1e}  {gap}  {record['replicas']:,} replicas  "
        f"seed {record['seed']}"
    )


def _retrier(item: pytest.Item) -> str:
    """What would run this test again if it fails; empty if nothing."""
    config = item.config
    plugins = [name for name, plugins in _RETRIERS.items() if any(map(config.pluginmanager.hasplugin, plugins))]
    if not plugins:
        return ""
    for name in ("reruns", "force_reruns", "retries", "force_flaky"):
        with contextlib.suppress(ValueError):  # getini: it is no ini value
            option = config.getoption(name, None)
            if config.getini(name) if option is None else option:
                return f"--{name.replace('_', '-')} (or {name} in the ini file)"
    marked = item.get_closest_marker("flaky") or hasattr(getattr(item, "obj", None), "_flaky_max_runs")
    return f"{' or '.join(plugins)}, by the mark flaky," if marked else ""
