"""How long the tests take: runs them all, or those that are named, and writes `tests/seconds.txt`.

    .venv/bin/python -m tests.support.seconds [what pytest takes: files, -n 2, -m 'not weekly' …]

Seconds are those of a processor, children included, which hardly depend on what else the machine does. The table has
each file, and below it the functions that take LONG; `tests/conftest.py` marks these as `slow`, and `make test-quick`
leaves them out. Of files that were not run the table stays as it is.
"""

from __future__ import annotations

import resource
import sys
from collections import defaultdict

import pytest

from tests.support import ROOT

TABLE = ROOT / "tests/seconds.txt"
HEAD = "# seconds of a processor of each file of tests, and of its functions that take more than half a second\n"
LONG = 0.5
_PROPERTY = "processor seconds"


def _spent() -> float:
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def read() -> dict[str, tuple[float, dict[str, float]]]:
    """The table: seconds by file, and by function."""
    table: dict[str, tuple[float, dict[str, float]]] = {}
    file = ""
    for line in TABLE.read_text(encoding="utf-8").splitlines() if TABLE.exists() else ():
        if line.startswith("#"):
            continue
        seconds, name = line.split()
        if "/" in name:
            file = name
            table[file] = float(seconds), {}
        else:
            table[file][1][name] = float(seconds)
    return table


def slow_functions() -> set[str]:
    """The functions that take long, as `file::function`."""
    return {f"{file}::{function}" for file, (_, functions) in read().items() for function in functions}


class Measuring:
    """A plugin that measures each test with its fixtures, in the process that runs it, and writes the table."""

    def __init__(self) -> None:
        self._start = 0.0
        self._seconds: defaultdict[str, defaultdict[str, float]] = defaultdict(lambda: defaultdict(float))

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logstart(self) -> None:
        """Begin."""
        self._start = _spent()

    def pytest_runtest_teardown(self, item: pytest.Item) -> None:
        """Attach what was spent to the report of the end."""
        item.user_properties.append((_PROPERTY, _spent() - self._start))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add up, where the reports of all processes arrive."""
        if report.when == "teardown":
            file, function = report.nodeid.partition("[")[0].split("::")[:2]
            spent = (value for name, value in report.user_properties if name == _PROPERTY)
            self._seconds[file][function] += sum(float(str(value)) for value in spent)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Write the table."""
        if hasattr(session.config, "workerinput") or not self._seconds:
            return
        table = {file: row for file, row in read().items() if (ROOT / file).exists()}
        for file, spent in self._seconds.items():
            table[file] = sum(spent.values()), {name: s for name, s in spent.items() if s > LONG}
        lines = [HEAD]
        for file, (seconds, functions) in sorted(table.items(), key=lambda row: -row[1][0]):
            lines.append(f"{seconds:7.1f} {file}\n")
            lines += [f"{s:15.1f} {name}\n" for name, s in sorted(functions.items(), key=lambda row: -row[1])]
        TABLE.write_text("".join(lines), encoding="utf-8")


def pytest_configure(config: pytest.Config) -> None:
    """Measure, in workers too, which load this module as the plugin that it is."""
    config.pluginmanager.register(Measuring())


if __name__ == "__main__":
    sys.exit(pytest.main(["-p", "tests.support.seconds", *sys.argv[1:]]))
