"""JSON Schemas of what `--json` prints, made from the types of the results by the walk that prints them
(`documents.as_json`): the fields of a dataclass, or its `json_fields`, with the types that are annotated there. Of a
calibration the schema is that of its file, from the record by which that is read.

They are shipped in `src/tumble/schemas`, a file for each command, and written by

    python -m tests.support.json_schemas
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from copy import deepcopy
from datetime import date, datetime
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

import tumble
from tests.support import ROOT
from tumble.inference.estimate import Fit, Outcome
from tumble.result.calibration import Calibration, json_schema

FOLDER = ROOT / "src/tumble/schemas"
_RECORD = {
    "record": "lab.registry.records.Record",
    "launches": [{"session": "str | None", "log_sha256": "str"}],
    "parameters": ["result.parts.Parameter"],
    "acceptance": "lab.conformity.Verdict | None",
}
RESULTS: Mapping[str, Any] = {
    "calibrate": "result.calibration.Calibration",
    "ellipsoid": "result.calibration.Calibration",
    "inspect": "run.observed.Observed",
    "noise": "run.quiet_samples.RecordedNoise",
    "check": ("use.check.FieldCheck", "use.check.CheckedRest", "use.stream.Notice"),
    "compare": "use.compare.Comparison",
    "plan": "planning.plan.Plan",
    "campaign": "campaigns.campaign.CampaignResult",
    "fleet": "campaigns.fleet.FleetResult",
    "registry-add": _RECORD,
    "registry-show": (_RECORD, "lab.datasheet.Datasheet"),
    "registry-list": {"records": ["lab.registry.records.Record"]},
    "registry-trend": "lab.registry.trend.Trend",
    "registry-limits": {"limits": ["lab.registry.records.LimitsRecord"]},
    "registry-due": {"devices": ["lab.registry.records.Due"]},
    "selftest": "lab.selftest.SelftestRecord",
}
"""What each command prints: a type by its place below `tumble`, a table of such, or one of several."""
EVENTS = ("check", "rest", "notice")
"""What the objects of a stream are, in the order of those of `check`; without a stream there is no `event`."""

_SIMPLE: Mapping[Any, Mapping[str, Any]] = {
    str: {"type": "string"},
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    float: {"type": ["number", "null"]},  # which is null where it is not finite
    NoneType: {"type": "null"},
    Path: {"type": "string"},
    date: {"type": "string", "format": "date"},
    datetime: {"type": "string", "format": "date-time"},
    Any: {},
    object: {},
}


class Walk:
    """The types that a result holds, each described once, in `definitions`."""

    def __init__(self) -> None:
        self.definitions: dict[str, dict[str, Any]] = {}
        modules = [import_module(each.name) for each in walk_packages(tumble.__path__, "tumble.")]
        self._names = {name: value for module in modules for name, value in vars(module).items()}
        """What annotations use that their module imports for type checkers alone."""

    def schema(self, hint: Any) -> dict[str, Any]:
        """The schema of the values of a type; of a text the type of that place below `tumble`."""
        origin, inner = get_origin(hint), get_args(hint)
        if isinstance(hint, str):
            return self.schema(self._named(hint))
        if isinstance(hint, dict):
            return self._table({name: self.schema(each) for name, each in hint.items()})
        if isinstance(hint, list):
            return {"type": "array", "items": self.schema(hint[0])}
        if hint in _SIMPLE:
            return dict(_SIMPLE[hint])
        if origin is Literal:
            return {"enum": list(inner)}
        if origin in (Union, UnionType):
            return self._either(inner)
        if origin is np.ndarray:
            whole = np.issubdtype(get_args(inner[1])[0], np.integer)
            return self._numbers("integers" if whole else "numbers")
        if isinstance(origin, type) and issubclass(origin, Mapping):
            return {"type": "object", "additionalProperties": self.schema(inner[1])}
        if origin is tuple and inner[-1] is not Ellipsis:
            return {
                "type": "array",
                "prefixItems": list(map(self.schema, inner)),
                "items": False,
                "minItems": len(inner),
            }
        if isinstance(origin, type) and issubclass(origin, Sequence):
            return {"type": "array", "items": self.schema(inner[0])}
        return self._of_class(hint)

    def _named(self, text: str) -> Any:
        """The type that a text names."""
        parts = [part.strip() for part in text.split("|")]
        if len(parts) > 1:
            return Union[tuple(map(self._named, parts))]  # noqa: UP007
        module, _, name = parts[0].rpartition(".")
        return getattr(import_module(f"tumble.{module}"), name) if module else {"str": str, "None": NoneType}[name]

    def _either(self, kinds: Sequence[Any]) -> dict[str, Any]:
        every = [self.schema(kind) for kind in kinds]
        if all(each.keys() == {"type"} for each in every):
            names = [name for each in every for name in np.atleast_1d(each["type"]).tolist()]
            return {"type": list(dict.fromkeys(names))}
        return {"anyOf": every}

    def _numbers(self, name: str) -> dict[str, Any]:
        """Numbers of an array of any number of dimensions."""
        place = {"$ref": f"#/$defs/{name}"}
        one: Sequence[str] = ["integer"] if name == "integers" else ["number", "null"]
        self.definitions[name] = {"type": [*one, "array"], "items": place}
        return place

    def _of_class(self, kind: type[Any]) -> dict[str, Any]:
        """The fields of a class; of one with a length, a list of its rows."""
        name = kind.__name__
        place = {"$ref": f"#/$defs/{name}"}
        if name in self.definitions:
            return place
        self.definitions[name] = {}
        if kind is Calibration:
            self.definitions[name] = self._calibration()
            return place
        names = getattr(kind, "json_fields", None) or kind.__dataclass_fields__
        hints = self._hints(kind, kind)
        columns = {each: hints[each] if each in hints else self._of_property(kind, each) for each in names}
        described = self._table({each: self.schema(hint) for each, hint in columns.items()})
        self.definitions[name] = {"type": "array", "items": described} if hasattr(kind, "__len__") else described
        return place

    def _of_property(self, kind: type[Any], name: str) -> Any:
        """What a property gives, of the class or of one that it is derived from."""
        return self._hints(kind, getattr(kind, name).fget)["return"]

    def _hints(self, kind: type[Any], annotated: Any) -> dict[str, Any]:
        its = {name for each in kind.__mro__ for name in vars(import_module(each.__module__))}
        return get_type_hints(annotated, localns={n: v for n, v in self._names.items() if n not in its})

    @staticmethod
    def _table(properties: Mapping[str, Any]) -> dict[str, Any]:
        return {
            "type": "object",
            "properties": dict(properties),
            "required": list(properties),
            "additionalProperties": False,
        }

    def _calibration(self) -> dict[str, Any]:
        """The calibration file, whose record may be read with less than is written."""
        found, printed = json_schema(), {kind.__name__: kind for kind in (Fit, Outcome)}
        self.definitions |= {n: _bare(each) for n, each in found.pop("$defs").items() if n not in printed}
        for kind in printed.values():
            self._of_class(kind)
        bare: dict[str, Any] = _bare(found)
        return bare | {"required": list(bare["properties"])}


def _bare(schema: Any, names: bool = False) -> Any:
    """A schema of pydantic as those of the other results are; `names`: its keys are those of a table."""
    if isinstance(schema, list):
        return [_bare(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    kept = {key: each for key, each in schema.items() if names or key not in ("title", "default", "description")}
    return {key: _bare(each, key == "properties" and not names) for key, each in kept.items()}


def schema_of(command: str) -> dict[str, Any]:
    """The schema of what a command prints."""
    walk, result = Walk(), RESULTS[command]
    every = [walk.schema(each) for each in (result if isinstance(result, tuple) else (result,))]
    tables = [deepcopy(walk.definitions[each["$ref"].rpartition("/")[2]]) if "$ref" in each else each for each in every]
    for table in tables:
        table["properties"] = {"format": {"const": 1}, **table["properties"]}
        table["required"] = list(dict.fromkeys(["format", *table["required"]]))
    for table, event in zip(tables, EVENTS, strict=False) if command == "check" else ():
        table["properties"]["event"] = {"const": event}
        table["required"] += [] if event == "check" else ["event"]
    if command == "calibrate":
        tables[0]["properties"]["others"] = {"type": "array", "items": {"$ref": "#"}}
    head = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"tumble {command.replace('-', ' ')} --json",
    }
    body = tables[0] if len(tables) == 1 else {"anyOf": tables}
    everything = json.dumps([tables, walk.definitions])
    parts = {name: part for name, part in walk.definitions.items() if f'"#/$defs/{name}"' in everything}
    return head | body | ({"$defs": parts} if parts else {})


def text_of(command: str) -> str:
    """The file of a command."""
    return json.dumps(schema_of(command), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    for name in RESULTS:
        (FOLDER / f"{name}.json").write_text(text_of(name), encoding="utf-8")
