"""The command `plan` and the function give the same of the same set-up, by default too."""

from __future__ import annotations

import json

from click.testing import CliRunner

import tumble
from tumble.cli import main
from tumble.documents import as_json


def test_the_command_and_the_library_have_the_same_defaults() -> None:
    shown = CliRunner().invoke(main, ["plan", "--json"])
    by_command = json.loads(shown.stdout)
    by_library = json.loads(json.dumps(as_json(tumble.plan(tumble.Setup.of()))))
    del by_command["format"]
    assert by_command == by_library
