"""Checks of the arguments of public functions against their annotations."""

from __future__ import annotations

import builtins
import os
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cache, wraps
from inspect import Parameter, signature
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from tumble.errors import InputError
from tumble.units import Array

P = ParamSpec("P")
R = TypeVar("R")

_SHOWN = 40
_ADVICE: Mapping[str | tuple[str, ...], str] = {
    "complex": "give their real part",
    ("D", "T"): "give seconds: (t - t[0]).dt.total_nanoseconds() / 1e9",  # polars
    "": "give seconds: (t - t[0]) / np.timedelta64(1, 's')",
}
"""What to give instead of numbers of other types, by the first letters of the type."""
_PLAIN: Mapping[Any, tuple[str, tuple[type, ...]]] = {
    str: ("text", (str,)),
    float: ("a number", (Real,)),
    int: ("a whole number", (Integral,)),
    bool: ("True or False", (bool, np.bool_)),
    os.PathLike: ("a path", (os.PathLike,)),
    NoneType: ("None", (NoneType,)),
}


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function to raise InputError for arguments of other types than it annotates.

    Numbers may be those of NumPy, and sequences arrays; their values are for the function itself to check."""
    parameters = signature(function).parameters
    qualified_name = function.__qualname__.removesuffix(".__init__")

    @cache
    def hints_by_name() -> Mapping[str, Any]:
        return get_type_hints(function, localns=_Names(function))

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        for name, given in signature(function).bind(*args, **kwargs).arguments.items():
            kind, hint = parameters[name].kind, hints_by_name().get(name, Any)  # self has none
            if kind is Parameter.VAR_KEYWORD:
                hints = get_type_hints(get_args(hint)[0]) if get_args(hint) else {}
                _check(qualified_name, given, hints)
            else:
                for value in given if kind is Parameter.VAR_POSITIONAL else (given,):
                    _check(qualified_name, {name: value}, {name: hint})
        return function(*args, **kwargs)

    return call


def array_of(what: str, given: npt.ArrayLike | None) -> Array:
    """Return an array of real numbers from an array, a sequence or a frame. Raises InputError for anything else."""
    if type(given) is np.ndarray and given.dtype.char == "d":
        return given
    if isinstance(given, np.ma.MaskedArray) and np.ma.is_masked(given):
        masked = int(np.ma.getmaskarray(given).sum())
        raise InputError(f"{what}: expected numbers, found {masked} that are masked; cut or fill them")
    try:
        if given is None:
            raise TypeError("give readings")
        numbers = np.asarray(given)
        texts = numbers.flat if numbers.dtype.kind == "O" else ()
        if numbers.dtype.kind in "SU" or any(isinstance(each, str | bytes) for each in texts):
            raise TypeError("it has text; convert the text to numbers, such as with astype(float)")
        dtypes: Any = getattr(given, "dtypes", None)  # one for each column of a frame
        if dtypes is None and numbers.dtype.kind == "f":
            return numbers if numbers.dtype.char == "d" else numbers.astype(np.float64)
        if dtypes is None:
            dtypes = getattr(given, "dtype", None) or numbers.dtype
        for dtype in map(str, np.ravel(dtypes)):
            if dtype.lower().startswith(("date", "time", "duration", "complex")):
                advice = next(text for start, text in _ADVICE.items() if dtype.startswith(start))
                raise InputError(f"{what}: expected numbers, found {dtype}; {advice}")
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what}: expected an array of numbers, found {type(given).__name__}: {error}") from None


class _Names(dict[str, Any]):
    """Names in the annotations of a function that its module imports only for type checkers."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__()
        self._imported = function.__globals__

    def __missing__(self, name: str) -> Any:
        import tumble

        if name in self._imported or hasattr(builtins, name):
            raise KeyError(name)
        return getattr(tumble, name) if name in tumble.__all__ else Any


def _check(function: str, given: Mapping[str, Any], hints: Mapping[str, Any]) -> None:
    for name, value in given.items():
        fits, words = _expected(hints.get(name, Any))
        if not fits(value):
            shown = repr(value) if isinstance(value, str | int | float | tuple | list | dict) else type(value).__name__
            raise InputError(
                f"--{name.replace('_', '-')}: expected {words}, found {shown[:_SHOWN]}; see help(tumble.{function})"
            )


@cache
def _expected(hint: Any) -> tuple[Callable[[Any], bool], str]:
    """Return the test whether a value is of an annotated type, and the type in words."""
    origin: Any = get_origin(hint) or hint
    args = get_args(hint)
    if origin in _PLAIN:
        words, types = _PLAIN[origin]

        def is_plain(value: Any) -> bool:
            is_0d_array = origin in (int, float) and isinstance(value, np.ndarray) and value.ndim == 0
            is_misplaced_bool = isinstance(value, bool | np.bool_) and origin is not bool
            return is_0d_array or (isinstance(value, types) and not is_misplaced_bool)

        return is_plain, words
    if origin is Literal:
        return lambda value: isinstance(value, tuple(map(type, args))), ", ".join(map(str, args))
    if origin is np.ndarray:
        return _is_numeric, "an array of numbers"
    if origin in (Union, UnionType):
        tests = [_expected(one)[0] for one in args]
        has_path = any(get_origin(one) is os.PathLike for one in args)
        in_words = dict.fromkeys(_expected(one)[1] for one in args if not (one is str and has_path))
        return lambda value: any(fits(value) for fits in tests), " or ".join(in_words)
    if origin is Any or not isinstance(origin, type) or getattr(origin, "_is_protocol", False):
        return lambda _value: True, getattr(origin, "__name__", "")
    if origin is Callable or not issubclass(origin, Iterable) or not args:
        return callable if origin is Callable else lambda value: isinstance(value, origin), origin.__name__
    fits, words = _expected(args[issubclass(origin, Mapping)])
    if issubclass(origin, Mapping):
        in_mapping = "a mapping" if args[1] is Any else f"a mapping of names to {words}"
        return lambda value: isinstance(value, Mapping) and all(map(fits, value.values())), in_mapping
    tests = [_expected(one)[0] for one in args] if issubclass(origin, tuple) and args[-1] is not Ellipsis else []

    def holds(value: Any) -> bool:
        if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
            return False
        if tests:
            return len(list(value)) == len(tests) and all(test(one) for test, one in zip(tests, value, strict=True))
        if not isinstance(value, Collection):  # an iterator, which can be read only once
            return origin is Iterable
        return all(map(fits, value))

    return holds, f"several, each {words}"


def _is_numeric(value: Any) -> bool:
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except ValueError:  # rows of different lengths
        return False
