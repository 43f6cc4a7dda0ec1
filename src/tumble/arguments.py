"""Arguments of public functions are of the types that are annotated, or refused in one line."""

from __future__ import annotations

import builtins
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import cache, wraps
from inspect import Parameter, signature
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from tumble.errors import InputError

P = ParamSpec("P")
R = TypeVar("R")

_SHOWN = 40
_PLAIN: Mapping[Any, tuple[str, tuple[type, ...]]] = {
    str: ("text", (str,)),
    float: ("a number", (Real,)),
    int: ("a whole number", (Integral,)),
    bool: ("True or False", (bool, np.bool_)),
    os.PathLike: ("a path", (os.PathLike,)),
    NoneType: ("None", (NoneType,)),
}


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """A function that raises InputError for arguments of other types than it states. Numbers may be those of NumPy, and
    sequences arrays; which texts and numbers may be given is for the function itself to say."""
    parameters = signature(function).parameters

    @cache
    def stated() -> Mapping[str, Any]:
        return get_type_hints(function, localns=_Names(function))

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        for name, given in signature(function).bind(*args, **kwargs).arguments.items():
            kind, hint = parameters[name].kind, stated()[name]
            if kind is Parameter.VAR_KEYWORD:
                hints = get_type_hints(get_args(hint)[0]) if get_args(hint) else {}
                _check(function.__name__, given, hints)
            else:
                for value in given if kind is Parameter.VAR_POSITIONAL else (given,):
                    _check(function.__name__, {name: value}, {name: hint})
        return function(*args, **kwargs)

    return call


class _Names(dict[str, Any]):
    """Names that the annotations of a function use and its module imports for type checkers alone."""

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
        if name in hints and not _fits(value, hints[name]):
            shown = repr(value) if isinstance(value, str | int | float | tuple | list) else f"{type(value).__name__}"
            raise InputError(
                f"--{name.replace('_', '-')}: expected {' or '.join(dict.fromkeys(_in_words(hints[name])))}, found "
                f"{shown[:_SHOWN]}; see help(tumble.{function})"
            )


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value is of a type."""
    origin: Any = get_origin(hint) or hint
    of = get_args(hint)
    if origin in _PLAIN:
        number_of_0_dimensions = origin in (int, float) and isinstance(value, np.ndarray) and value.ndim == 0
        truth = isinstance(value, bool | np.bool_) and origin is not bool
        return number_of_0_dimensions or (isinstance(value, _PLAIN[origin][1]) and not truth)
    if origin is Literal:
        return any(isinstance(value, type(one)) for one in of)
    if origin is np.ndarray:
        try:
            return np.asarray(value).dtype.kind in "biuf"
        except ValueError:  # of rows that are not of one length
            return False
    if getattr(origin, "_is_protocol", False):
        return True
    if origin in (Union, UnionType):
        return any(_fits(value, one) for one in of)
    if origin is Any or not isinstance(origin, type):
        return True
    if origin is Callable or not issubclass(origin, Iterable) or not of:
        return callable(value) if origin is Callable else isinstance(value, origin)
    if issubclass(origin, Mapping):
        return isinstance(value, Mapping) and all(_fits(one, of[1]) for one in value.values())
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        return False
    if issubclass(origin, tuple) and of[-1] is not Ellipsis:
        return len(list(value)) == len(of) and all(map(_fits, value, of))
    if not isinstance(value, Collection):  # a stream, which can be looked at once
        return origin is Iterable
    return all(_fits(one, of[0]) for one in value)


def _in_words(hint: Any) -> Iterator[str]:
    """The types that fit, in words."""
    origin: Any = get_origin(hint) or hint
    of = get_args(hint)
    if origin in _PLAIN:
        yield _PLAIN[origin][0]
    elif origin is Literal:
        yield ", ".join(map(str, of))
    elif origin is np.ndarray:
        yield "an array of numbers"
    elif origin in (Union, UnionType):
        paths = any(get_origin(one) is os.PathLike for one in of)
        for one in of:
            yield from () if one is str and paths else _in_words(one)
    elif of and issubclass(origin, Iterable) and not issubclass(origin, Mapping):
        yield f"several, each {' or '.join(dict.fromkeys(_in_words(of[0])))}"
    else:
        yield {Mapping: "a mapping"}.get(origin, origin.__name__)
