"""Blocks as a piece of HTML for a notebook: no template, everything escaped."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

from tumble.views.blocks import Block, Items, Table, Text


def fragment(blocks: Iterable[Block]) -> str:
    """Sentences, lists and tables as HTML."""
    return f"<div>{''.join(map(_html, blocks))}</div>"


def _html(block: Block) -> str:
    if isinstance(block, Text):
        return f"<p><b>{escape(block.text)}</b></p>"
    if isinstance(block, Items):
        return f"<ul>{_each('li', block.items)}</ul>"
    if isinstance(block, Table):
        rows = "".join(f"<tr>{_each('td', row)}</tr>" for row in block.rows)
        head = f"<thead><tr>{_each('th', block.columns)}</tr></thead>"
        return f"<table>{head}<tbody>{rows}</tbody></table>"
    return ""


def _each(tag: str, texts: Iterable[str]) -> str:
    return "".join(f"<{tag}>{escape(text)}</{tag}>" for text in texts)
