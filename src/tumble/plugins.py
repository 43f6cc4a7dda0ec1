"""Extensions by other packages, found by their entry points.

    group                 object of an entry point
    tumble.commands       a command of click
    tumble.exports        a `Target`, or the path of a template (`tumble.export`)
    tumble.readers        a `Reader` of recordings (`tumble.recording.formats`)
    tumble.programmes     the attitude codes of the positions in order (`tumble.programme.positions`)
    tumble.parameters     a `ParameterGroup` (`tumble.sensors.parameters`)
    tumble.knowledge      a context manager that opens a `Knowledge` at a place (`tumble.commands.params`)
    tumble.reports        a function that writes a report by a further file: limits, certificate

Built-in names take precedence: entry points are searched only for other names and for lists. Objects are imported on
use. `lab` and `bench` also add their commands and exports in this way.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Literal, TypeVar

from tumble.errors import InputError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Kind = Literal["commands", "exports", "readers", "programmes", "parameters", "reports", "knowledge"]
T = TypeVar("T")


@cache
def entry_points_of(kind: Kind) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name, in the order of their packages' names."""
    from importlib.metadata import entry_points

    found = entry_points(group=f"tumble.{kind}")
    return {point.name: point for point in sorted(found, key=lambda point: (package_of(point), point.name))}


def package_of(point: EntryPoint) -> str:
    """Return the name of the package that declares an entry point."""
    return point.dist.name if point.dist is not None else point.module.partition(".")[0]


def load(kind: Kind, name: str, expected: type[T] | tuple[type[T], ...]) -> T | None:
    """Import the object of an entry point; None if no package declares the name.

    `kind` is the group without "tumble.". Raises InputError, which names the package, if the object cannot be imported
    or is not of an `expected` type."""
    point = entry_points_of(kind).get(name)
    if point is None:
        return None
    where = f"package {package_of(point)}, entry point tumble.{kind}: {name} = {point.value}"
    remedy = "mend the package or uninstall it"
    try:
        loaded = point.load()
    except Exception as error:
        message = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"{where}: expected an object that can be imported, found {message}; {remedy}") from error
    if not isinstance(loaded, expected):
        types = expected if isinstance(expected, tuple) else (expected,)
        wanted = " or ".join(each.__name__ for each in types)
        raise InputError(f"{where}: expected a {wanted}, found a {type(loaded).__name__}; {remedy}")
    return loaded


def load_all(kind: Kind, expected: type[T] | tuple[type[T], ...]) -> dict[str, T]:
    """Import the objects of all entry points of a group, by name. Raises InputError as `load` does."""
    loaded = {name: load(kind, name, expected) for name in entry_points_of(kind)}
    return {name: each for name, each in loaded.items() if each is not None}
