"""A report as one page of HTML that needs nothing else: no script, no font, no other file."""

from __future__ import annotations

import re
from dataclasses import asdict, is_dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from tumble.report.blocks import Document
from tumble.report.characters import everywhere, visible


def page(document: Document) -> str:
    """The HTML of a report. All text is escaped; only the figures, which hold no text, are markup."""
    content = everywhere(asdict(document), visible, except_key="svg")
    return _environment().get_template("page.html").render(document=content) + "\n"


def rendered(template: str, **content: Any) -> str:
    """A page by a template of this folder; all text is escaped."""
    visible_content = everywhere({key: _plain(value) for key, value in content.items()}, visible, except_key="svg")
    return _environment().get_template(template).render(**visible_content) + "\n"


def _plain(value: Any) -> Any:
    """Dataclasses in mappings and lists as mappings."""
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("tumble.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["inline"] = _inline
    environment.filters["css"] = _css
    return environment


def _css(text: str) -> Markup:
    """A text in a string of CSS: every character by its code, so that none can end the string."""
    return Markup("".join(f"\\{ord(character):06x}" for character in text))


def _inline(svg: str) -> Markup:
    """A figure as part of a page, where SVG needs no name spaces."""
    return Markup(re.sub(r' xmlns(:\w+)?="[^"]*"', "", svg).replace(" xlink:href=", " href="))
